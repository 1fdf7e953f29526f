"""The plane: all wheels of the array and all parcels on it, moved step by step."""

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics import plane
from mdms_sim.physics.parcel import parcel_records, read_poses
from mdms_sim.physics.scene import Scene
from mdms_sim.physics.sensors import counts_per_m, encoder_counts, presence_bits
from mdms_sim.physics.wheels import Grid, build_wheels, wheel_records
from mdms_sim.record import Event, Floats
from mdms_sim.scenario import Scenario


class World:
    """Wheels, parcels, friction and what the cells can sense of them.

    Wheels (W,) are ordered by cell, then axis; poses and twists (P, 3) are those of the parcels'
    geometric centres in the table frame. Forces and contacts are those of the step just made.
    """

    def __init__(self, scenario: Scenario) -> None:
        array, cell = scenario.array, scenario.cell
        self.wheels = build_wheels(scenario)
        self.time_s = 0.0
        self.events: list[Event] = []
        self.scenario = scenario
        self._records = wheel_records(scenario, self.wheels)
        parcels, edges = parcel_records(scenario.parcel)
        self._wheel_grid = Grid(
            array.columns, array.rows, array.pitch_m, _reach([w.offset_m for w in cell.wheel])
        )
        self._sensor_grid = self._wheel_grid._replace(reach_m=_reach(cell.sensor_offset_m))
        self._sensor_offset_m = np.array(cell.sensor_offset_m, dtype=np.float64)
        self._presence = np.zeros(array.columns * array.rows, dtype=np.uint8)
        self._counts_per_m = counts_per_m(cell)
        count = len(self._records)
        self.scene = Scene(
            grid=self._wheel_grid,
            first=self.wheels.first,
            wheels=self._records,
            parcels=parcels,
            edges=edges,
            gravity_m_s2=scenario.run.gravity_m_s2,
            support=np.zeros(count, dtype=np.int64),
            piece=np.zeros(count, dtype=np.int8),
            spot_m=np.zeros((count, 2)),
            jacobian=np.zeros((count, 3)),
            line=np.zeros((count, 3)),
            normal_n=np.zeros(count),
        )

    # Motion --------------------------------------------------------------------------------------

    def step_ideal(self, reference_m_s: Floats, step_s: float) -> None:
        """Move on under the continuous proportional law with massless wheels; references (W,)."""
        tipped = plane.step_ideal(self.scene, reference_m_s, step_s)
        self.pass_time(step_s, tipped)

    def step_voltage(self, voltage_v: Floats, step_s: float) -> None:
        """Move on under voltages (W,) held over the step, within supply and PWM resolution."""
        tipped = plane.step_voltage(self.scene, voltage_v, step_s)
        self.pass_time(step_s, tipped)

    def pass_time(self, step_s: float, tipped: bool) -> None:
        """Advance the clock after the scene has moved, and report parcels that began to tip."""
        self.time_s += step_s
        if tipped:
            self._report_tips()

    def _report_tips(self) -> None:
        told = {event.parcel for event in self.events if event.kind == "tip"}
        for parcel, body, pose in zip(
            self.scenario.parcel, self.scene.parcels, self.pose, strict=True
        ):
            if body["tipped"] and parcel.name not in told:
                where = f"at x {pose[0]:.4f} m, y {pose[1]:.4f} m, yaw {pose[2]:.4f} rad"
                detail = f"centre of mass left the supports {where}"
                self.events.append(Event(self.time_s, "tip", detail, parcel=parcel.name))

    # Parcels -------------------------------------------------------------------------------------

    @property
    def pose(self) -> Floats:
        """Poses (P, 3) [m, m, rad]."""
        return self._motion()[0]

    @property
    def twist(self) -> Floats:
        """Twists (P, 3) [m/s, m/s, rad/s]."""
        return self._motion()[1]

    def _motion(self) -> tuple[Floats, Floats]:
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
    def contact(self) -> NDArray[np.int8]:
        """`Contact` codes (W,)."""
        codes: NDArray[np.int8] = self._records["contact"].astype(np.int8)
        return codes

    def _state(self, name: str) -> Floats:
        values: Floats = self._records[name].copy()
        return values

    # Senses --------------------------------------------------------------------------------------

    def encoder_counts(self) -> NDArray[np.int32]:
        """Encoder counts (W,), wrapping at 31 bits."""
        return encoder_counts(self._records["travel_m"], self._counts_per_m)

    def presence(self) -> NDArray[np.uint8]:
        """Presence bits (cells,): bit s is the sensor at `cell.sensor_offset_m[s]`."""
        presence_bits(
            self._sensor_grid,
            self.scene.parcels,
            self.scene.edges,
            self._sensor_offset_m,
            self._presence,
        )
        return self._presence.copy()


def _reach(offsets_m: object) -> float:
    return float(np.abs(np.array(offsets_m, dtype=np.float64)).max(initial=0.0))
