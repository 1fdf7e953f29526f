"""The plane: all wheels of the array and all parcels on it, moved step by step."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import Grid, build_cells, build_wheels, reach_m
from mdms_model.arrays import Floats
from mdms_model.compiled import for_types_of
from mdms_model.parcel import parcel_records, read_poses
from mdms_model.run.record import Event
from mdms_model.scenario.scenario import Scenario
from mdms_sim.physics.motor import true_cells
from mdms_sim.physics.plane import step
from mdms_sim.physics.plane.control_step import Bridges, Registers, Sampled, step_cells
from mdms_sim.physics.plane.scene import Scene
from mdms_sim.physics.plane.sensors import LoadCells, PresenceSensors, counts_per_m
from mdms_sim.physics.plane.touch import NOW, TOUCH
from mdms_sim.physics.plane.wheels import wheel_records

#: Convex parcels in the plane have at most six neighbours on average, and two points with each.
TOUCHES_PER_PARCEL = 6


class World:
    """Wheels, parcels, friction and what the cells can sense of them.

    Wheels (W,) are ordered by cell, then axis; poses and twists (P, 3) are those of the parcels'
    origins in the table frame. Forces and contacts are those of the step just made. What happened,
    parcels that touch or tip, is in `events`. Raises `ScenarioError` for impossible outlines.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.wheels = build_wheels(scenario)
        self.scene = build_scene(scenario)
        self.time_s = 0.0
        self.events: list[Event] = []
        self._presence = PresenceSensors(scenario)
        noise_n = scenario.cell.load_cell_noise_n
        self._load_cells = None if noise_n is None else LoadCells(scenario, noise_n)
        counts, current_ma = np.zeros((2, len(self.scene.first) - 1, 2), np.int32)
        self.sampled = Sampled(counts_per_m(scenario.cell), counts, current_ma)
        supply_v = np.array([cell.supply_v for cell in build_cells(scenario)])
        awake, shut_off = np.ones(len(counts), np.int32), np.zeros(len(counts), np.int32)
        self.bridges = Bridges(awake, shut_off, supply_v)

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
        news = self._step_cells(self.scene, voltage_uv, self.bridges, step_s, self.sampled)
        self.pass_time(step_s, news)

    @cached_property
    def _step_cells(self) -> Callable[[Scene, Registers, Bridges, float, Sampled], int]:
        # It runs every millisecond, and sorting out its arguments would take as long as the step.
        types = self.scene, self.sampled.counts, self.bridges, 0.0, self.sampled
        return for_types_of(step_cells, *types)

    def pass_time(self, step_s: float, news: int) -> None:
        """Advance the clock after the scene has moved, and note what it had to tell."""
        self.time_s += step_s
        if news & step.TIPPING:
            self._note_tips()
        if news & step.TOUCHING:
            self._note_touches()

    def _note_tips(self) -> None:
        told = {event.parcel for event in self.events if event.kind == "tip"}
        for parcel, tipped, pose in zip(
            self.scenario.parcel, self.scene.parcels["tipped"], self.pose, strict=True
        ):
            if tipped and parcel.name not in told:
                where = f"at x {pose[0]:.4f} m, y {pose[1]:.4f} m, yaw {pose[2]:.4f} rad"
                detail = f"the supports no longer hold its centre of mass, {where}"
                self.events.append(Event(self.time_s, "tip", detail, parcel=parcel.name))

    def _note_touches(self) -> None:
        names = [parcel.name for parcel in self.scenario.parcel]
        touches = self.scene.touches[: self.scene.tally[NOW]]
        told: set[tuple[int, int]] = set()
        for touch in touches[touches["fresh"] == 1]:
            pair = int(touch["a"]), int(touch["b"])
            if pair not in told:
                told.add(pair)
                where = f"at x {touch['x_m']:.4f} m, y {touch['y_m']:.4f} m"
                detail = f"touches {names[pair[1]]} {where}"
                self.events.append(Event(self.time_s, "touch", detail, parcel=names[pair[0]]))

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
        pose, twist = np.empty((2, len(self.scene.parcels), 3))
        read_poses(self.scene.parcels, pose, twist)
        return pose, twist

    # Wheels --------------------------------------------------------------------------------------

    @property
    def wheel_speed_m_s(self) -> Floats:
        """Surface speeds (W,) along the wheels' directions."""
        return self._state("speed_m_s")

    @property
    def wheel_travel_m(self) -> Floats:
        """Surface travel (W,) since the start."""
        return self._state("travel_m")

    @property
    def normal_n(self) -> Floats:
        """Normal forces (W,)."""
        return self._state("normal_n")

    @property
    def force_n(self) -> Floats:
        """What the wheels push the parcels with, along their directions (W,)."""
        return self._state("force_n")

    @property
    def slip_m_s(self) -> Floats:
        """How fast sliding wheels' surfaces run ahead of the parcels on them (W,), else 0."""
        return self._state("slip_m_s")

    @property
    def contact(self) -> NDArray[np.int8]:
        """`Contact` codes (W,)."""
        codes: NDArray[np.int8] = self.scene.wheels["contact"].astype(np.int8)
        return codes

    @property
    def motor_current_a(self) -> Floats:
        """What the motors draw at the end of a step under voltage (W,), signed as the voltage."""
        return self._state("current_a")

    def _state(self, name: str) -> Floats:
        values: Floats = self.scene.wheels[name].copy()
        return values

    # Senses --------------------------------------------------------------------------------------

    def presence(self) -> NDArray[np.uint8]:
        """Presence bits (cells,), bit s for the sensor at `cell.sensor_offset_m[s]`.

        Every call is one reading of the sensors, which the scenario may make late and noisy.
        """
        return self._presence.read(self.scene, self.time_s)

    def load_n(self) -> Floats | None:
        """One reading of the load cells (W,); None where the scenario has none."""
        return self._load_cells.read(self.normal_n) if self._load_cells else None


def build_scene(scenario: Scenario) -> Scene:
    """The arrays of a scenario at its start. Raises `ScenarioError` for impossible outlines."""
    array, wheels, cells = scenario.array, build_wheels(scenario), true_cells(scenario)
    offsets = [wheel.offset_m for cell in cells for wheel in cell.wheel]
    parcels, edges = parcel_records(scenario.parcel)
    count = len(wheels.cell)
    return Scene(
        grid=Grid(array.columns, array.rows, array.pitch_m, reach_m(offsets)),
        first=wheels.first,
        wheels=wheel_records(wheels, cells),
        parcels=parcels,
        edges=edges,
        gravity_m_s2=scenario.run.gravity_m_s2,
        order=np.arange(len(parcels)),
        touches=np.zeros(TOUCHES_PER_PARCEL * len(parcels), dtype=TOUCH),
        tally=np.zeros(2, dtype=np.int64),
        partners=np.zeros((TOUCHES_PER_PARCEL * len(parcels), 2), dtype=np.int64),
        support=np.zeros(count, dtype=np.int64),
        spot_m=np.zeros((count, 2)),
        normal_n=np.zeros(count),
        jacobian=np.zeros((2 * count, 3)),
        line=np.zeros((2 * count, 3)),
        piece=np.zeros(2 * count, dtype=np.int8),
    )
