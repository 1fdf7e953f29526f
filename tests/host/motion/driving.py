"""Wheels of the paper's model and a parcel on them, as tests of motion need them."""

from collections.abc import Callable, Collection

import numpy as np
from tests.host.motion.believing import beliefs

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.carrying import Carrying
from mdms_host.motion.trajectory.follower import Carried
from mdms_host.motion.trajectory.path import Path, shorter_turn_rad
from mdms_host.motion.trajectory.pushes import Mass, uniform_mass
from mdms_host.motion.trajectory.traction import Traction, wheel_drives_of
from mdms_model.arrays import Floats
from mdms_model.scenario.scenario import Array, Cell, Scenario, Wheel
from mdms_model.scenario.scenario import Parcel as TrueParcel
from mdms_sim.physics.plane.world import World

#: As on the prototype.
WHEELS = ((0.0, (-0.03, 0.0)), (np.pi / 2, (0.03, 0.0)))
LAYOUT = Layout(6, 3, wheels=tuple(WheelPlace(*wheel) for wheel in WHEELS))
BOX = Parcel("box", 0.36, 0.30)
BOX_KG = 2.0
STEP_S = 0.01
#: The world moves in steps of this.
FINE_S = 0.002


def traction_of(layout: Layout = LAYOUT, speed_m_s: float = 0.1, friction: float = 0.3) -> Traction:
    drives = wheel_drives_of(Cell(), np.full(len(layout.wheel_cells), 10.0))
    return Traction(layout, drives, friction=friction, speed_m_s=speed_m_s)


def mass_of(parcel: Parcel, mass_kg: float = BOX_KG) -> Mass:
    return uniform_mass(parcel.footprint, mass_kg)


def straight(start: Floats, end: Floats, reach_m: float) -> Path:
    """The path straight from a pose to another, by the shorter turn."""
    turn_rad = shorter_turn_rad(float(start[2]), float(end[2]))
    return Path(np.array([start, [end[0], end[1], start[2] + turn_rad]]), reach_m)


class Table:
    """One parcel on the wheels of a layout, by the paper's model.

    As from cells: the command of a cycle drives the next one. The believed twist is that of the
    wheels, one cycle old, as is the true pose that it carries on. The wheels of cells that are
    `lost` (from 1) are braked.
    """

    def __init__(
        self,
        pose: Floats,
        parcel: Parcel = BOX,
        layout: Layout = LAYOUT,
        *,
        friction: float = 0.3,
        mass_kg: float = BOX_KG,
        lost: Collection[int] = (),
    ) -> None:
        self.parcel = parcel
        self._lost = np.isin(layout.wheel_cells, [*lost])
        self._layout = layout
        self._carrying = Carrying(layout, traction_of(layout).drives)
        self._world = World(_scenario(layout, parcel, pose, friction, mass_kg))
        self._next_m_s: Floats = np.zeros(len(layout.wheel_cells))
        self.pose, self.twist = self._world.pose[0], self._world.twist[0]
        self.most_slip_m_s = 0.0
        self.slipping = 0
        self.carrying = 0

    def step(self, command: Callable[..., Carried | None]) -> None:
        """One cycle; `command` returns the command of the wheels, given a belief."""
        belief = self.belief()
        carried, references_m_s = command(belief, STEP_S), np.zeros(len(self._next_m_s))
        if carried is not None:
            name = self.parcel.name
            outlines, places = {name: self.parcel.footprint}, {name: belief.pose}
            references_m_s = self._carrying.references_m_s({name: carried}, outlines, places)
        self.move(references_m_s)

    def belief(self) -> Belief:
        """The belief of the parcel at the end of the cycle."""
        twist = self.rolling_twist()
        ahead = self.pose + twist * STEP_S
        return beliefs({self.parcel.name: ahead}, [self.parcel], twist=twist)[self.parcel.name]

    def move(self, references_m_s: Floats) -> None:
        """Pass a cycle; the references (W,) count from its end on."""
        going_m_s, self._next_m_s = self._next_m_s, np.where(self._lost, 0.0, references_m_s)
        for _ in range(round(STEP_S / FINE_S)):
            self._world.step_ideal(going_m_s, FINE_S)
        self.pose, self.twist = self._world.pose[0], self._world.twist[0]
        slips_m_s = abs(self._world.slip_m_s)
        self.most_slip_m_s = max(self.most_slip_m_s, float(slips_m_s.max()))
        self.slipping += int((slips_m_s > 0.005).sum())
        self.carrying += int((self._world.normal_n > 0.0).sum())

    @property
    def tipped(self) -> bool:
        """Whether the parcel has tipped off its wheels."""
        return any(event.kind == "tip" for event in self._world.events)

    def rolling_twist(self) -> Floats:
        """The twist that the speeds of the wheels under the parcel show; the lost report none."""
        under = (self._world.normal_n > 0.0) & ~self._lost
        rows = self._layout.surface_jacobian(*self.pose[:2].tolist())[under]
        twist: Floats = np.linalg.lstsq(rows, self._world.wheel_speed_m_s[under], rcond=None)[0]
        return twist


def _scenario(
    layout: Layout, parcel: Parcel, pose: Floats, friction: float, mass_kg: float
) -> Scenario:
    x_m, y_m, yaw_rad = (float(value) for value in pose)
    wheels = tuple(Wheel(wheel.direction_rad, wheel.offset_m) for wheel in layout.wheels)
    true = TrueParcel(parcel.name, mass_kg, parcel.length_m, parcel.width_m, x_m, y_m, yaw_rad)
    cell = Cell(wheel=wheels, friction=friction)
    return Scenario("table", Array(layout.columns, layout.rows, layout.pitch_m), cell, (true,))
