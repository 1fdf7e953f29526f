"""The plane: all wheels of the array and all parcels on it, moved step by step."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import build_cells, build_wheels
from mdms_model.arrays import Bools, Floats, Records
from mdms_model.compiled import for_types_of
from mdms_model.run.record import Event
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_sim.physics.plane import step
from mdms_sim.physics.plane.control_step import (
    Bridges,
    LoadCells,
    PresenceSensors,
    Registers,
    Sampled,
    SenseState,
    counts_per_m,
    step_cells,
)
from mdms_sim.physics.plane.handling import Streams, StreamsState
from mdms_sim.physics.plane.records import (
    DROPPED,
    NOW,
    TIPPED,
    TIPS,
    UNBALANCED,
    UNSOLVED,
    Scene,
    build_scene,
    read_poses,
    starts_of,
)

#: Failures of the solver, by its counters.
SOLVER_LIMITS = {
    DROPPED: "touches between parcels found no room",
    UNSOLVED: "twists of parcels were not found in the steps allowed",
    UNBALANCED: "forces between parcels were not found in the rounds allowed",
}


@dataclass(frozen=True, slots=True)
class WorldSnapshot:
    """A world at one instant, apart from it; see `World.state`."""

    time_s: float
    events: tuple[Event, ...]
    limits: frozenset[int]
    arrays: tuple[Any, ...]
    senses: tuple[SenseState, ...]
    streams: StreamsState


class World:
    """Wheels, parcels, friction and the senses of the cells.

    Wheels (W,) are ordered by cell, then axis; poses and twists (P, 3) are those of the parcels'
    origins in the table frame. Forces and contacts are those of the step just made. The past is in
    `events`: parcels that touch or tip, and limits of the solver ('solver'), each when a step
    reaches it and the one before did not. Faults of wheels, sensors and bridges are part of the
    state; `handling` has the acts of hands on parcels. Raises `ScenarioError` for impossible
    outlines.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.wheels = build_wheels(scenario)
        self.scene = build_scene(scenario)
        self.time_s = 0.0
        self.events: list[Event] = []
        self._limits: frozenset[int] = frozenset()
        self._presence = PresenceSensors(scenario)
        self.stuck_sensors = self._presence.stuck
        self.streams = Streams(scenario)
        noise_n = scenario.cell.load_cell_noise_n
        self._load_cells = None if noise_n is None else LoadCells(scenario, noise_n)
        counts, current_ma = np.zeros((2, len(self.scene.model.first) - 1, 2), np.int32)
        self.sampled = Sampled(counts_per_m(scenario.cell), counts, current_ma)
        supply_v = np.array([cell.supply_v for cell in build_cells(scenario)])
        awake = np.ones(len(counts), np.int32)
        shut_off, shorted = np.zeros((2, len(counts)), np.int32)
        self.bridges = Bridges(awake, shut_off, supply_v, shorted)

    # To come back to -----------------------------------------------------------------------------

    def state(self) -> WorldSnapshot:
        """All that the future depends on, to be given to `restore`, as often as wanted."""
        return WorldSnapshot(
            self.time_s,
            tuple(self.events),
            self._limits,
            tuple(array.copy() for array in self._arrays()),
            tuple(sense.state() for sense in self._senses()),
            self.streams.state(),
        )

    def restore(self, state: WorldSnapshot) -> None:
        """Go back: the same steps and readings as then give the same bytes.

        The arrays stay at their places, so that the owner of a part of the world still has it.
        """
        self.time_s, self._limits = state.time_s, state.limits
        self.events[:] = state.events
        for array, kept in zip(self._arrays(), state.arrays, strict=True):
            array[...] = kept
        for sense, kept in zip(self._senses(), state.senses, strict=True):
            sense.restore(kept)
        self.streams.restore(state.streams)

    def _arrays(self) -> tuple[Any, ...]:
        sampled = self.sampled.counts, self.sampled.current_ma
        return *self.scene.state, *sampled, *self.bridges, self.stuck_sensors

    def _senses(self) -> tuple[PresenceSensors | LoadCells, ...]:
        return (self._presence, self._load_cells) if self._load_cells else (self._presence,)

    # Motion --------------------------------------------------------------------------------------

    def step_ideal(self, reference_m_s: Floats, step_s: float) -> None:
        """Move on under the continuous proportional law with massless wheels; references (W,)."""
        self.pass_time(step_s, step.step_ideal(self.scene, reference_m_s, step_s))

    def step_voltage(self, voltage_v: Floats, step_s: float) -> None:
        """Move on under voltages (W,) held over the step, within supply, PWM and current limit."""
        self.pass_time(step_s, step.step_voltage(self.scene, voltage_v, step_s))

    def step_cells(self, voltage_uv: Registers, step_s: float) -> None:
        """The same under voltages as cells hold them (cells, 2), and the state of their `bridges`.

        `sampled` is of the step's end.
        """
        voltage_uv = np.ascontiguousarray(voltage_uv, np.int32)
        report = self._step_cells(self.scene, voltage_uv, self.bridges, step_s, self.sampled)
        self.pass_time(step_s, report)

    @cached_property
    def _step_cells(self) -> Callable[[Scene, Registers, Bridges, float, Sampled], int]:
        # It runs every millisecond, and sorting out its arguments would take as long as the step.
        types = self.scene, self.sampled.counts, self.bridges, 0.0, self.sampled
        return for_types_of(step_cells, *types)

    def pass_time(self, step_s: float, report: int) -> None:
        """Advance the clock after the scene has moved, and note its events."""
        self.time_s += step_s
        if report & step.TIPPING:
            self._note_tips()
        if report & step.TOUCHING:
            self._note_touches()
        if step_s and (self._limits or report & step.LIMITED):
            self._note_limits(report)
        if step_s and self.streams.due(self.time_s):
            self.events += self.streams.bring(self.scene, self.time_s, self.pose)

    def _note_tips(self) -> None:
        states = self.scene.state.parcels
        for number, (parcel, pose) in enumerate(zip(self.scenario.parcel, self.pose, strict=True)):
            tipped = states["tipped"][number]
            if tipped and (leaves := self.streams.take(self.scene, number, self.time_s)):
                self.events.append(leaves)
            elif tipped == TIPS:
                states["tipped"][number] = TIPPED
                where = f"at x {pose[0]:.4f} m, y {pose[1]:.4f} m, yaw {pose[2]:.4f} rad"
                detail = f"the supports no longer hold its centre of mass, {where}"
                self.events.append(Event(self.time_s, "tip", detail, parcel=parcel.name))

    def _note_touches(self) -> None:
        names = [parcel.name for parcel in self.scenario.parcel]
        touches = self.scene.scratch.touches[: self.scene.scratch.tally[NOW]]
        noted: set[tuple[int, int]] = set()
        for touch in touches[touches["fresh"] == 1]:
            pair = int(touch["a"]), int(touch["b"])
            if pair not in noted:
                noted.add(pair)
                where = f"at x {touch['x_m']:.4f} m, y {touch['y_m']:.4f} m"
                detail = f"touches {names[pair[1]]} {where}"
                self.events.append(Event(self.time_s, "touch", detail, parcel=names[pair[0]]))

    def _note_limits(self, report: int) -> None:
        tally = self.scene.scratch.tally
        limits = frozenset(
            limit for limit in SOLVER_LIMITS if report & step.LIMITED and tally[limit]
        )
        for limit in sorted(limits - self._limits):
            detail = f"{SOLVER_LIMITS[limit]} ({tally[limit]} in this step)"
            self.events.append(Event(self.time_s, "solver", detail))
        self._limits = limits

    # Parcels -------------------------------------------------------------------------------------

    @property
    def pose(self) -> Floats:
        """Poses (P, 3) [m, m, rad]."""
        return self.motion[0]

    @property
    def twist(self) -> Floats:
        """Twists (P, 3) [m/s, m/s, rad/s]."""
        return self.motion[1]

    @property
    def motion(self) -> tuple[Floats, Floats]:
        """Poses and twists at once."""
        pose, twist = np.empty((2, len(self.scene.model.parcels), 3))
        self._read_poses(self.scene.model.parcels, self.scene.state.parcels, pose, twist)
        return pose, twist

    @cached_property
    def _read_poses(self) -> Callable[[Records, Records, Floats, Floats], None]:
        poses = np.empty((len(self.scene.model.parcels), 3))
        types = self.scene.model.parcels, self.scene.state.parcels, poses, poses
        return for_types_of(read_poses, *types)

    def put_back(self, parcels: Sequence[Parcel]) -> None:
        """Put the parcels that are on the table where these are, at rest."""
        start, here = starts_of(parcels), self.scene.state.parcels
        on = here["away"] == 0
        for name in ("x_m", "y_m", "yaw_rad", "vx_m_s", "vy_m_s", "yaw_rate_rad_s"):
            here[name][on] = start[name][on]

    # Wheels --------------------------------------------------------------------------------------

    @property
    def wheel_speed_m_s(self) -> Floats:
        """Surface speeds (W,) along the wheels' directions."""
        return self._wheel("speed_m_s")

    @property
    def wheel_travel_m(self) -> Floats:
        """Surface travel (W,) since the start."""
        return self._wheel("travel_m")

    @property
    def normal_n(self) -> Floats:
        """Normal forces (W,)."""
        return self._wheel("normal_n")

    @property
    def force_n(self) -> Floats:
        """The pushes of the wheels on the parcels, along their directions (W,)."""
        return self._wheel("force_n")

    @property
    def slip_m_s(self) -> Floats:
        """How fast sliding wheels' surfaces run ahead of the parcels on them (W,), else 0."""
        return self._wheel("slip_m_s")

    @property
    def contact(self) -> NDArray[np.int8]:
        """`Contact` codes (W,)."""
        codes: NDArray[np.int8] = self.scene.state.wheels["contact"].astype(np.int8)
        return codes

    @property
    def is_driven(self) -> Bools:
        """Whether the bridge of each motor drives it (W,); others are open or shorted."""
        shorted = self.bridges.shorted.take(self.wheels.cell) != 0
        driven: Bools = (self.scene.state.wheels["coasting"] == 0) & ~shorted
        return driven

    @property
    def motor_current_a(self) -> Floats:
        """The motor currents at the end of a step under voltage (W,), signed as the voltage."""
        return self._wheel("current_a")

    def _wheel(self, name: str) -> Floats:
        values: Floats = np.array(self.scene.state.wheels[name])
        return values

    # Senses --------------------------------------------------------------------------------------

    def presence(self) -> NDArray[np.uint8]:
        """Presence bits (cells,), bit s for the sensor at `cell.sensor_offset_m[s]`.

        Every call is one reading of the sensors, which the scenario may make late and noisy.
        """
        return self._presence.read(self.scene, self.time_s)

    def misread(self, bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Presence bits as sensors with the scenario's noise, and with their faults, show them."""
        return self._presence.misread(bits)

    def load_n(self) -> Floats | None:
        """One reading of the load cells (W,); None where the scenario has none."""
        return self._load_cells.read(self.normal_n) if self._load_cells else None
