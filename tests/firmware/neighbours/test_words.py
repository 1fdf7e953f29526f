"""Viper code of the neighbour layer keeps to words of 32 bits, as boards have them.

Where it does, bytecode and the machine code of any board compute the same.
"""

from hypothesis import given, settings
from hypothesis import strategies as st

from mdms_cell.motion import leading, steering
from mdms_cell.perception import agreement, belief, footprint, outline, sensors, twist
from mdms_cell.perception.angle import TURN_UM, root
from mdms_cell.perception.outline import DISC, RECTANGLE, STEP_UM
from mdms_cell.perception.place import STEPS

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


class Words(list):
    """A buffer of words."""

    def __init__(self, values):
        super().__init__(map(Word, values))

    def __setitem__(self, index, value):
        super().__setitem__(index, Word(value))


def numbers(most):
    return st.integers(-most, most).map(Word)


turns = numbers(TURN_UM // 2)
halves = st.integers(2_000, HALF)
#: What a frame may say of a wheel [um/s].
speeds = st.binary(min_size=18 * 4, max_size=18 * 4)


@given(st.integers(0, 2_000_000_000))
def test_root_fits(number):
    assert root(Word(number)) ** 2 <= number


def placed(shape, pose, halves):
    x, y, turn = pose
    registers = Words([0, 0, 0, 0, shape, *halves, *[0] * 25])
    outline.place(registers, x * STEP_UM, y * STEP_UM, turn)
    return registers


def cells_around(xs, ys, along=(0, 0, 0, 0), shifts=()):
    """The registers of a footprint."""
    points = [*xs, *[0] * (7 - len(xs)), *ys, *[0] * (7 - len(ys))]
    return Words([*points, *along, *shifts, *[0] * (18 - len(shifts)), 255, 4000])


@given(
    st.sampled_from([RECTANGLE, DISC]),
    st.tuples(numbers(NEAR), numbers(NEAR), turns),
    st.tuples(halves, halves),
)
def test_outline_fits_wherever_the_parcel_lies(shape, pose, halves):
    registers = placed(shape, pose, halves)
    xs, ys = [NEAR, -NEAR, 0, 0, NEAR, 0, 0], [NEAR, NEAR, 0, -NEAR, 0, 0, 0]
    cells = cells_around(xs, ys, shifts=[NEAR, -NEAR, -NEAR, NEAR])
    footprint.points_within(registers, cells, Word(0), 2, Word(625))
    footprint.squares_overlapped(registers, cells, Word(3))
    outline.edge(registers, Word(NEAR), Word(-NEAR))
    sensors._compare(registers, cells, Word(0), Word(31))


@settings(max_examples=60)
@given(st.lists(speeds, min_size=3, max_size=8), numbers(HALF), numbers(HALF), turns, st.data())
def test_twist_fits_whatever_speeds_come(beats, centre_x, centre_y, turn, data):
    registers = placed(RECTANGLE, (centre_x, centre_y, turn), (Word(2 * HALF), Word(2 * HALF)))
    along = data.draw(st.lists(numbers(362), min_size=4, max_size=4))
    wheels, shifts = (
        st.lists(numbers(NEAR // 2), min_size=size, max_size=size) for size in (2, 18)
    )
    cells = cells_around(data.draw(wheels), data.draw(wheels), along, data.draw(shifts))
    for beat in beats:
        mask = Word(data.draw(st.integers(0, (1 << 9) - 1)))
        frames = Words([*bytes(64), *beat])
        twist.fit(registers, cells, frames, mask)
        twist.against(registers, cells, frames, Word(4), Word(3))


@given(
    st.lists(st.tuples(numbers(HALF), numbers(HALF), st.booleans()), max_size=30),
    numbers(NEAR * STEP_UM),
    numbers(NEAR * STEP_UM),
    turns,
)
def test_belief_fits_whatever_sensors_say(edges, x_um, y_um, turn):
    registers = placed(RECTANGLE, (0, 0, 0), (HALF, HALF))
    believed = (x_um, y_um, turn, *[belief._START] * 3, *[0] * 7)
    moving = (1_300_000, -1_300_000, 500_000, 0, 0, 1_300_000, -1_300_000, 500_000)
    registers = Words([*registers[: belief.X], *believed, *moving])
    for x, y, exact in edges:
        x_um, y_um, turn = registers[belief.X : belief.TURN + 1]
        outline.place(registers, x_um, y_um, turn)
        off = outline.edge(registers, x, y)
        belief._correct(registers, off, Word(belief.EDGE), exact)
        belief.roll(registers, Word(2 * 1000 // 10))
        belief.send(registers, Word(1000 // 50), Words([0] * 10))


@given(
    st.lists(st.tuples(numbers(2047), numbers(2047), numbers(2047)), min_size=8, max_size=8),
    st.lists(st.integers(0, 15).map(Word), min_size=8, max_size=8),
    st.integers(0, 15).map(Word),
)
def test_agreement_fits_whatever_neighbours_say(poses, certainties, certainty):
    fields = [
        (*pose, 7, 3, 0, sure, 5, 1, 0) for pose, sure in zip(poses, certainties, strict=True)
    ]
    estimates = Words([each for row in fields for each in row])
    sent = [each * number for each, number in zip(poses[0], (250, 250, 196), strict=True)]
    registers = placed(RECTANGLE, (0, 0, 0), (HALF, HALF))
    believed = (*sent, *[belief._MOST] * 3, 0, 0, 0, 0, *sent)
    registers = Words([*registers[: belief.X], *believed, *[0] * 8])
    around, sums = (estimates, STEPS, Word(127_000)), Words([0] * 5)
    near = agreement.near_mask(*around, Word(255), registers, belief.SENT)
    if agreement.sum_up(*around, Word(near), registers, bytes(9), certainty, sums):
        belief.agree(registers, sums, Word(agreement.OWN_WEIGHT))


@given(
    st.lists(st.tuples(numbers((1 << 17) - 1), numbers((1 << 17) - 1), numbers(2047)), min_size=4),
    st.lists(st.tuples(numbers(HALF), numbers(HALF), turns), min_size=4),
    st.tuples(numbers(100_000_000), numbers(100_000_000)),
    st.lists(st.integers(0, 255).map(Word), min_size=2, max_size=2),
    halves,
)
def test_steering_fits_wherever_the_goal_is(goals, poses, place_um, limits, half):
    """Limits are those of the acceleration and of the speed."""
    registers = Words([0] * leading._REGISTERS)
    reach = [NEAR, -NEAR]
    cells = cells_around(reach, reach, (362, -362, 362, 362), [NEAR, NEAR, -NEAR, -NEAR])
    for goal, pose in zip(goals, poses, strict=False):
        x, y, turn = pose
        bottom = placed(RECTANGLE, pose, (half, half))
        believed = x * STEP_UM, y * STEP_UM, turn, *[0] * 10
        moving = 1_300_000, -1_300_000, 500_000, *[0] * 5
        parcel = Words([*bottom[: belief.X], *believed, *moving, half * STEP_UM])
        for place, number in enumerate((*goal, *limits), steering.LEFT):
            registers[place] = number
        steering.find_wish(registers, parcel, *place_um)
        for step_ms in (1, 50):
            steering.approach(registers, parcel, 1, Word(step_ms))
        leading._aim(registers, parcel, cells)
        # With less the parcel moves on for tens of metres, where squares leave words and are apart.
        registers[steering.ACCELERATION] = Word(255)
        leading._look_ahead(parcel, parcel, registers, cells, Word(3))
        leading._look_nearer(parcel, parcel, registers, cells, Word(3))
