"""Which cells a parcel needs, beside the model's exact outlines."""

from math import hypot
from random import Random
from types import SimpleNamespace

import pytest
from tests.firmware.neighbours.outlines import exact_m
from tests.firmware.neighbours.some_place import SENSORS_UM, SHIFTS_UM, WHEELS_UM, SomePlace

from mdms_cell.motion.leading import Leading
from mdms_cell.motion.program import Program
from mdms_cell.perception.angle import ARM_UM
from mdms_cell.perception.belief import Belief
from mdms_cell.perception.footprint import Footprint
from mdms_cell.perception.outline import DISC, RECTANGLE
from mdms_cell.perception.place import OWN, STEPS
from mdms_cell.perception.twist import WHEELS
from mdms_protocol.neighbours import frames as wire

PITCH_M = SomePlace.pitch_um * 1e-6
ACCELERATION_M_S2 = 0.5
#: A parcel brakes so long after a promise has lapsed.
REACTION_S = 0.2
#: Small ones, which lie over few of the nine cells.
SHAPES = ((RECTANGLE, 0.24, 0.12), (RECTANGLE, 0.16, 0.14), (DISC, 0.16, 0.16))


class Tracking:
    """A parcel alone on a table where ways are planned."""

    others = 0

    def __init__(self) -> None:
        self.belief = Belief()

    def may_be_elsewhere(self) -> bool:
        """Never."""
        return False


class Axes:
    """Wheels that are off."""

    def rest(self) -> None:
        """Nothing to be done."""


def needs(shape, length_m, width_m, pose, twist) -> int:
    """The mask of the neighbours that a parcel needs that moves so [m/s, rad/s]."""
    pitch_um = SomePlace.pitch_um
    shifts_um = [(STEPS[at] * pitch_um, STEPS[at + 1] * pitch_um) for at in range(0, 16, 2)]
    place = SomePlace(shifts_um=shifts_um)
    footprint, tracking = Footprint(place), Tracking()
    belief = tracking.belief
    belief.set(shape, round(length_m * 1e6), round(width_m * 1e6))
    x_m, y_m, yaw_rad = pose
    belief.start(round(x_m * 1e6), round(y_m * 1e6), round(yaw_rad * ARM_UM))
    for axis, scale in enumerate((1e6, 1e6, ARM_UM)):
        belief.twist.speeds[axis] = round(twist[axis] * scale)
    acceleration = round(ACCELERATION_M_S2 * 1000) // wire.ACCELERATION_MM_S2
    program = Program()
    program.take((1, wire.PARCEL, 1, shape, 1000, 1000, acceleration, 100, 0))
    program.take((1, wire.GOAL, 1, 0, 0, 0, 0, 0, 0))
    leading = Leading(place, footprint, tracking, Axes(), lambda _direction: None)
    leading.look_ahead(program)
    return leading.needs


def covers(parcel, direction) -> bool:
    """Whether it lies over that neighbour's square, by a millimetre or more."""
    centre_m = (STEPS[2 * direction] * PITCH_M, STEPS[2 * direction + 1] * PITCH_M, 0.0)
    side_m = PITCH_M - 0.002
    return exact_m(parcel, (RECTANGLE, side_m, side_m, centre_m)) < 0.0


@pytest.mark.parametrize("seed", range(3))
def test_parcel_needs_each_cell_that_it_is_over_or_would_be_over_where_it_stands(seed) -> None:
    random = Random(seed)
    ahead = 0
    for _ in range(200):
        shape, length_m, width_m = random.choice(SHAPES)
        pose = [random.uniform(-bound, bound) for bound in (0.06, 0.06, 3.1)]
        twist = [random.uniform(-bound, bound) for bound in (0.2, 0.2, 1.0)]
        speed_m_s = hypot(twist[0], twist[1])
        time_s = REACTION_S + speed_m_s / (2 * ACCELERATION_M_S2)
        end = [each + speed * time_s for each, speed in zip(pose, twist, strict=True)]
        found = needs(shape, length_m, width_m, pose, twist)
        for direction in range(8):
            here = covers((shape, length_m, width_m, tuple(pose)), direction)
            there = covers((shape, length_m, width_m, tuple(end)), direction)
            assert found >> direction & 1 or not (here or there), (pose, twist, direction)
            ahead += there and not here
    assert ahead > 60


def test_wheels_at_the_goal_hold_and_are_switched_off_once() -> None:
    told = []
    axes = SimpleNamespace(lead=lambda _: told.append("lead"), rest=lambda: told.append("rest"))
    axes.driving = axes.follow = lambda: told[-1:] == ["lead"]
    place, tracking = SomePlace(), Tracking()
    place.x_um = place.y_um = 0
    belief, program = tracking.belief, Program()
    belief.set(RECTANGLE, 300_000, 300_000)
    belief.start(0, 0, 0)
    belief.twist.shown[WHEELS] = 8
    program.take((1, wire.PARCEL, 1, RECTANGLE, 1200, 1200, 44, 20, 0))
    program.take((1, wire.GOAL, 1, 0, 0, 0, 0, 0, 0))
    leading = Leading(place, Footprint(place), tracking, axes, lambda _direction: None)
    for _ in range(200):
        leading.step(program, True, 10)
    # Thirty beats until it has arrived, and fifty that it is held.
    assert told == 78 * ["lead"] + ["rest"]


@pytest.mark.parametrize("seed", range(3))
def test_wheels_roll_as_fast_as_the_parcel_carries_them(seed) -> None:
    random = Random(seed)
    footprint = Footprint(SomePlace(WHEELS_UM + SENSORS_UM, shifts_um=SHIFTS_UM))
    parcel = Belief()
    parcel.set(RECTANGLE, 360_000, 300_000)
    for _ in range(50):
        x_um, y_um = random.uniform(-150e3, 150e3), random.uniform(-150e3, 150e3)
        parcel.start(round(x_um), round(y_um), random.randint(-ARM_UM, ARM_UM))
        footprint.find_levers(parcel, 511)
        vx, vy, turn = random.uniform(-5e5, 5e5), random.uniform(-5e5, 5e5), random.uniform(-2, 2)
        twist = round(vx), round(vy), round(turn * ARM_UM)
        for direction, (cell_x, cell_y) in enumerate([*SHIFTS_UM, (0, 0)]):
            along_x = vx - turn * (cell_y + WHEELS_UM[0][1] - y_um)
            along_y = vy + turn * (cell_x + WHEELS_UM[1][0] - x_um)
            assert footprint.wheel_speed(direction, 0, twist) == pytest.approx(along_x, abs=1500)
            assert footprint.wheel_speed(direction, 1, twist) == pytest.approx(along_y, abs=1500)
    assert direction == OWN
