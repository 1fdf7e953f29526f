"""Numbers of the neighbour layer are words of 32 bits, as boards have them.

Where they are, bytecode and the machine code of any board compute the same. Steering computes with
integers of any size, and keeps words.
"""

from array import array
from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st
from tests.firmware.neighbours.some_place import SomePlace

from mdms_cell.motion.leading import Leading
from mdms_cell.motion.program import Program
from mdms_cell.perception.angle import TURN_UM, root
from mdms_cell.perception.belief import EDGE, MOST, Belief
from mdms_cell.perception.footprint import Footprint
from mdms_cell.perception.heard import Heard
from mdms_cell.perception.outline import (
    DISC,
    HALF_LENGTH,
    HALF_WIDTH,
    RECTANGLE,
    SHAPE,
    STEP_UM,
    gap,
)
from mdms_cell.perception.place import AXES, DIRECTIONS, SENSORS
from mdms_cell.perception.sensors import Comparison
from mdms_cell.perception.suspicion import Suspicion
from mdms_cell.perception.tracking import Agreement
from mdms_cell.perception.twist import against, fit
from mdms_protocol.neighbours import frames as wire

WORD = 1 << 31
#: Half of the largest parcel, and how far wheels and sensors of neighbours are [steps].
HALF = 300_000 // STEP_UM
NEAR = 200_000 // STEP_UM


class Word(int):
    """An integer that refuses to leave 32 bits, as a machine word would silently."""

    def __new__(cls, value):
        assert -WORD <= value < WORD, f"{int(value)} is no word"
        return super().__new__(cls, value)


def _checked(name):
    operation = getattr(int, name)

    def checked(self, other):
        result = operation(self, other)
        return result if result is NotImplemented else Word(result)

    return checked


for _name in ("add", "sub", "mul", "floordiv", "mod", "and", "or", "xor", "lshift", "rshift"):
    setattr(Word, f"__{_name}__", _checked(f"__{_name}__"))
    setattr(Word, f"__r{_name}__", _checked(f"__r{_name}__"))


Word.__abs__ = lambda self: Word(int.__abs__(self))
Word.__neg__ = lambda self: Word(int.__neg__(self))


class Words(list):
    """A buffer of words."""

    def __init__(self, values):
        super().__init__(map(Word, values))

    def __setitem__(self, index, value):
        super().__setitem__(index, Word(value))


class Kept(Words):
    """A buffer of words that are computed with as integers of any size."""

    def __getitem__(self, index):
        return int(super().__getitem__(index))

    def __iter__(self):
        return map(int, super().__iter__())


def worded(part, buffer=Words):
    """The same object, its arrays made of words."""
    for name, value in vars(part).items():
        if isinstance(value, array):
            setattr(part, name, buffer(value))
    return part


def numbers(most):
    return st.integers(-most, most).map(Word)


turns = numbers(TURN_UM // 2)
halves = st.integers(2_000, HALF)
#: The speeds of a wheel that a frame may have [um/s].
speeds = st.binary(min_size=18 * 4, max_size=18 * 4)


@given(st.integers(0, 2_000_000_000))
def test_root_fits(number):
    assert root(Word(number)) ** 2 <= number


def believed(shape, pose, halves, buffer=Words):
    """The belief of a parcel of this shape [steps], at x and y [steps] and a turn."""
    x, y, turn = pose
    belief = worded(Belief())
    worded(belief.twist, buffer)
    length, width = halves
    registers = belief.registers
    registers[SHAPE], registers[HALF_LENGTH], registers[HALF_WIDTH] = shape, length, width
    belief.reach_um = Word(length) * STEP_UM
    belief.start(x * STEP_UM, y * STEP_UM, turn, Word(MOST))
    return belief


def cells_around(points, shifts, along=((362, -362), (362, 362))):
    """A footprint with these points and shifts [steps] of up to eight neighbours."""
    count = AXES + SENSORS
    place = SomePlace(
        [(x * STEP_UM, y * STEP_UM) for x, y in [*points, *count * [(0, 0)]][:count]],
        [(x << 5, y << 5) for x, y in along],
        [(x * STEP_UM, y * STEP_UM) for x, y in [*shifts, *DIRECTIONS * [(0, 0)]][:DIRECTIONS]],
    )
    footprint = worded(Footprint(place))
    footprint.half = Word(4000)
    return footprint


@given(
    st.sampled_from([RECTANGLE, DISC]),
    st.tuples(numbers(NEAR), numbers(NEAR), turns),
    st.tuples(halves, halves),
)
def test_outline_fits_wherever_the_parcel_lies(shape, pose, halves):
    belief = believed(shape, pose, halves)
    points = [(NEAR, NEAR), (-NEAR, NEAR), (0, 0), (0, -NEAR), (NEAR, 0), (0, 0), (0, 0)]
    cells = cells_around(points, [(NEAR, -NEAR), (-NEAR, NEAR)])
    cells.within(belief, Word(0), Word(625))
    cells.squares(belief, Word(3))
    belief.edge(Word(NEAR), Word(-NEAR))
    Comparison().find(belief, cells, Word(0), Word(31))


@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([RECTANGLE, DISC]),
            st.tuples(numbers(HALF + NEAR), numbers(HALF + NEAR), turns),
            st.tuples(halves, halves),
        ),
        min_size=2,
        max_size=2,
    )
)
def test_gap_between_two_parcels_fits_wherever_they_lie(parcels):
    one, other = (believed(*parcel).registers for parcel in parcels)
    assert abs(gap(one, other) - gap(other, one)) <= 8


@given(st.lists(speeds, min_size=3, max_size=8), numbers(HALF), numbers(HALF), turns, st.data())
def test_twist_fits_whatever_speeds_come(beats, centre_x, centre_y, turn, data):
    belief = believed(RECTANGLE, (centre_x, centre_y, turn), (2 * HALF, 2 * HALF))
    pairs = (numbers(most) for most in (NEAR // 2, NEAR // 2, 362))
    points, shifts, along = (
        data.draw(st.lists(st.tuples(one, one), min_size=size, max_size=size))
        for one, size in zip(pairs, (AXES, DIRECTIONS, AXES), strict=True)
    )
    cells = cells_around(points, shifts, along)
    twist = belief.twist
    for beat in beats:
        mask = data.draw(st.integers(0, (1 << 9) - 1))
        frames = Words([*bytes(64), *beat])
        wheels = 0
        for cell in range(9):
            if mask >> cell & 1:
                wheels |= cells.within(belief, Word(cell), Word(0), AXES) << 2 * cell
        cells.find_levers(belief, 511)
        shown = (twist.speeds, twist.before, twist.shown)
        fit(*shown, cells.along, cells.levers, frames, Word(wheels))
        against(twist.speeds, cells, frames, Word(4), Word(3))


def moving(belief):
    """As fast as it may be."""
    twist = belief.twist
    twist.speeds[0], twist.speeds[1], twist.speeds[2] = 1_300_000, -1_300_000, 500_000
    twist.before[0], twist.before[1], twist.before[2] = 1_300_000, -1_300_000, 500_000


@given(
    st.lists(st.tuples(numbers(HALF), numbers(HALF), st.booleans()), max_size=30),
    numbers(NEAR),
    numbers(NEAR),
    turns,
)
def test_belief_fits_whatever_sensors_say(edges, x, y, turn):
    belief = believed(RECTANGLE, (x, y, turn), (HALF, HALF))
    belief.start(x * STEP_UM, y * STEP_UM, turn)
    moving(belief)
    for at_x, at_y, exact in edges:
        belief.correct(at_x, at_y, Word(EDGE), exact)
        belief.roll(Word(10))
        belief.move_outline()
        belief.send(Words([0] * wire.ESTIMATE_FIELDS), Word(50))


@given(
    st.lists(st.tuples(numbers(2047), numbers(2047), numbers(2047)), min_size=8, max_size=8),
    st.lists(st.integers(0, 15).map(Word), min_size=8, max_size=8),
    st.integers(0, 15).map(Word),
)
def test_agreement_fits_whatever_neighbours_say(poses, certainties, certainty):
    fields = [
        (*pose, 7, 3, 0, sure, 5, 1, 0) for pose, sure in zip(poses, certainties, strict=True)
    ]
    heard = Heard()
    heard.estimates = Words([each for row in fields for each in row])
    place = SimpleNamespace(shift_um=lambda _direction: (Word(127_000), Word(-127_000)))
    agreement = worded(Agreement(place, heard, Suspicion()))
    belief = believed(RECTANGLE, (0, 0, 0), (HALF, HALF))
    for axis, (number, step) in enumerate(zip(poses[0], (250, 250, 196), strict=True)):
        belief.sent[axis] = number * step
    agreement.compare(255, belief.sent)
    agreement.move(belief, certainty)
    agreement.follow(belief)


@given(
    st.lists(st.tuples(numbers((1 << 17) - 1), numbers((1 << 17) - 1), numbers(2047)), min_size=4),
    st.lists(st.tuples(numbers(HALF), numbers(HALF), turns), min_size=4),
    st.tuples(numbers(100_000_000), numbers(100_000_000)),
    st.lists(st.integers(0, 255), min_size=2, max_size=2),
    halves,
)
def test_steering_fits_wherever_the_goal_is(goals, poses, place_um, limits, half):
    """Limits are those of the acceleration and of the speed."""
    cells = cells_around([(NEAR, NEAR), (-NEAR, -NEAR)], [(NEAR, -NEAR), (NEAR, -NEAR)])
    cells.present = Word(3)
    for goal, pose in zip(goals, poses, strict=False):
        belief = believed(RECTANGLE, pose, (half, half), Kept)
        belief.reach_um = int(belief.reach_um)
        moving(belief)
        tracking = SimpleNamespace(belief=belief, may_be_elsewhere=lambda: False, others=Word(3))
        beside = believed(RECTANGLE, (NEAR, -NEAR, 0), (half, half))
        here = SimpleNamespace(x_um=place_um[0], y_um=place_um[1], pitch_um=1_000_000)
        axes = SimpleNamespace(lead=lambda targets: None, rest=lambda: None)
        axes.driving = axes.follow = lambda: True
        leading = Leading(here, cells, tracking, axes, lambda _direction, one=beside: one)
        worded(leading, Kept)
        steering = worded(leading.steering, Kept)
        for acceleration in (limits[0], 255):
            program = Program()
            program.take((1, wire.PARCEL, 1, RECTANGLE, 0, 0, acceleration, limits[1], 0))
            program.take((1, wire.GOAL, 1, *goal, 0, 0, 0))
            for step_ms in (1, 50):
                belief.twist.shown[0] = 8
                leading.step(program, True, step_ms)
                steering.approach(belief.reach_um, True, step_ms)
        # With less the parcel moves on for tens of metres, where squares leave words and are apart.
        leading.look_ahead(program, 3)
