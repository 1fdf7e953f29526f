"""Tables that are moved period by period: models of many, or cells with firmware on their bus."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from mdms_array.host import coordinator_of
from mdms_host.coordination.run_state import Phase
from mdms_host.motion.program import FieldProgram
from mdms_model.array import build_wheels
from mdms_model.arrays import Bits, Bools, Floats
from mdms_model.errors import Error, InputError
from mdms_model.scenario.motion import Motion
from mdms_model.scenario.scenario import Scenario
from mdms_sim.physics.plane.batch import Batch, check_alike
from mdms_sim.physics.plane.world import World, WorldSnapshot
from mdms_sim.simulation import Simulation, addresses_of, open_bank

#: A control period: one step of an environment [s].
PERIOD_S = 0.01
#: Cells come up within this, or something is wrong with them [s].
BRING_UP_S = 20.0
#: The outlines of the parcels of a table have so many edges at most.
MOST_EDGES = 64
FIDELITIES = ("ideal", "firmware")


class IdealTables:
    """Tables of massless wheels under the continuous law, moved by one compiled call.

    A table that begins with the same cells and outlines as before only puts its parcels back.
    """

    def __init__(self, scenarios: Sequence[Scenario], threads: int) -> None:
        run, cell = scenarios[0].run, scenarios[0].cell
        self._common = run.step_s, cell.sensor_delay_s
        self._refuse(scenarios[0])
        self._steps = max(1, round(PERIOD_S / run.step_s))
        self._step_s = PERIOD_S / self._steps
        late = round(cell.sensor_delay_s / self._step_s)
        if late >= self._steps:
            raise InputError(
                f"cell.sensor_delay_s is {cell.sensor_delay_s:g}, but the sensors of the ideal "
                f"fidelity are late by less than {PERIOD_S:g} s; take fidelity='firmware'"
            )
        #: Sensors show what was there so many steps ago.
        self._sensed = self._steps - late
        self._batch = Batch(scenarios, threads=threads, most_edges=MOST_EDGES)
        self._begun = [*scenarios]
        self._starts: list[WorldSnapshot] = [world.state() for world in self._batch.worlds]
        self._noisy = cell.sensor_noise > 0.0
        #: Poses and twists, once they have been read since the last step.
        self._motion: tuple[Floats, Floats] | None = None

    @property
    def worlds(self) -> Sequence[World]:
        """The truth of each."""
        return self._batch.worlds

    def begin(self, k: int, scenario: Scenario) -> None:
        """Have table k begin anew as this scenario. Raises `InputError` and `Error`."""
        self._refuse(scenario)
        if _alike(scenario, self._begun[k]):
            world = self._batch.worlds[k]
            world.restore(self._starts[k])
            world.put_back(scenario.parcel)
        else:
            self._starts[k] = self._batch.replace(k, scenario).state()
            self._begun[k] = scenario
            self._noisy = self._noisy or scenario.cell.sensor_noise > 0.0
        self._batch.sense(k)
        self._motion = None

    def _refuse(self, scenario: Scenario) -> None:
        """Raises `InputError` for a scenario that these tables cannot be."""
        firmware = "take fidelity='firmware'"
        if scenario.fault:
            raise InputError(f"fault is given, but the ideal fidelity has none; {firmware}")
        if (scenario.run.step_s, scenario.cell.sensor_delay_s) != self._common:
            raise InputError(
                "run.step_s or cell.sensor_delay_s is drawn for each episode, but tables of the "
                f"ideal fidelity share them; {firmware}"
            )

    def move(self, reference_m_s: Floats) -> None:
        """Move all by a control period under these references (N, W)."""
        self._batch.step_ideal(reference_m_s, self._step_s, self._steps, self._sensed)
        self._motion = None

    @property
    def presence(self) -> Bits:
        """One byte of presence bits a cell (N, cells), as the host has them."""
        bits = self._batch.presence
        if not self._noisy:
            return bits
        pairs = zip(self._batch.worlds, bits, strict=True)
        return np.array([world.misread(own) for world, own in pairs])

    @property
    def wheel_speed_m_s(self) -> Floats:
        """Speeds of the wheels (N, W), as the host has them."""
        return self._batch.wheel_speed_m_s

    @property
    def motion(self) -> tuple[Floats, Floats]:
        """True poses and twists of the parcels (N, P, 3); NaN for those that are away."""
        if self._motion is None:
            self._motion = self._batch.motion
        return self._motion

    @property
    def tipped(self) -> Bools:
        """Which have a parcel that has tipped off its supports (N,)."""
        return self._batch.tipped

    @property
    def faults(self) -> list[str | None]:
        """Why tables do not go on; empty while all do, as those of a model always do."""
        return []

    def close(self) -> None:
        """Release the resources of the tables."""


def _alike(scenario: Scenario, other: Scenario) -> bool:
    """Whether two scenarios differ by poses and goals of their parcels at most."""
    if len(scenario.parcel) != len(other.parcel):
        return False
    there = tuple(
        replace(one, x_m=two.x_m, y_m=two.y_m, yaw_rad=two.yaw_rad, goal=two.goal)
        for one, two in zip(scenario.parcel, other.parcel, strict=True)
    )
    return replace(scenario, parcel=there) == other


class FirmwareTables:
    """Tables whose cells run their firmware, under a host that sends references on the bus.

    Every beginning is a new table: its cells are brought up, which takes half a second of its time.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self._tables: list[_FirmwareTable | None] = [None] * len(scenarios)
        self._scenarios = scenarios

    @property
    def _up(self) -> "list[_FirmwareTable]":
        for k, table in enumerate(self._tables):
            if table is None:
                self.begin(k, self._scenarios[k])
        return [table for table in self._tables if table is not None]

    @property
    def worlds(self) -> Sequence[World]:
        """See `IdealTables`."""
        return [table.simulation.world for table in self._up]

    def begin(self, k: int, scenario: Scenario) -> None:
        """See `IdealTables`."""
        check_alike(self._scenarios[0], scenario, k)
        old = self._tables[k]
        if old is not None:
            old.close()
        self._tables[k] = _FirmwareTable(scenario)

    def move(self, reference_m_s: Floats) -> None:
        """See `IdealTables`."""
        for table, own_m_s in zip(self._up, reference_m_s, strict=True):
            table.move(own_m_s)

    @property
    def presence(self) -> Bits:
        """See `IdealTables`."""
        return np.array([table.simulation.reported_presence for table in self._up])

    @property
    def wheel_speed_m_s(self) -> Floats:
        """See `IdealTables`; 0 for a cell that has not reported yet."""
        return np.nan_to_num([table.coordinator.speeds_m_s for table in self._up])

    @property
    def motion(self) -> tuple[Floats, Floats]:
        """See `IdealTables`."""
        poses, twists = zip(*(table.simulation.world.motion for table in self._up), strict=True)
        return np.array(poses), np.array(twists)

    @property
    def tipped(self) -> Bools:
        """See `IdealTables`."""
        return np.array([world.scene.state.parcels["tipped"].any() for world in self.worlds])

    @property
    def faults(self) -> list[str | None]:
        """See `IdealTables`."""
        faults = [table.coordinator.fault for table in self._up]
        return faults if any(faults) else []

    def close(self) -> None:
        """See `IdealTables`."""
        for table in self._tables:
            if table is not None:
                table.close()
        self._tables = [None] * len(self._tables)


class _FirmwareTable:
    """One table with its cells, its bus and its host. Raises `Error` if it does not come up."""

    def __init__(self, scenario: Scenario) -> None:
        wheels = len(build_wheels(scenario).cell)
        still = Motion(field="table", table_m_s=(0.0,) * wheels)
        parcels = tuple(replace(parcel, goal=None) for parcel in scenario.parcel)
        scenario = replace(scenario, motion=still, task=(), parcel=parcels)
        self._bank = open_bank("cpython", addresses_of(scenario).node_ids)
        self.coordinator = coordinator_of(scenario)
        program = self.coordinator.program
        assert isinstance(program, FieldProgram)
        self._program = program
        self.simulation = Simulation(
            scenario, self._bank, [self.coordinator], recording=None, judged=False
        )
        self._now_s = 0.0
        self._advance(BRING_UP_S, up=False)
        if self.coordinator.phase is not Phase.RUNNING:
            why = self.coordinator.fault or f"still {self.coordinator.phase}"
            self.close()
            raise Error(f"the table does not come up: {why}")

    def move(self, reference_m_s: Floats) -> None:
        """Move by a period; the host sends the references with its next setpoints."""
        self._program.drive(reference_m_s)
        self._advance(PERIOD_S, up=True)

    def _advance(self, duration_s: float, *, up: bool) -> None:
        end_s = self._now_s + duration_s
        while self._now_s < end_s - PERIOD_S / 2:
            if not up and self.coordinator.phase is Phase.RUNNING:
                return
            self._now_s += PERIOD_S
            self.simulation.kernel.run_until(round(self._now_s * 1e9))

    def close(self) -> None:
        """End its cells."""
        with suppress(OSError):
            self._bank.close()


#: N tables that are moved together, each by the references of its own wheels.
Tables = IdealTables | FirmwareTables
