"""From a pose and a goal to a twist, in numbers that a 32-bit board bears."""

from math import hypot, sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_cell.motion import leading
from mdms_cell.motion.leading import Steering, length
from mdms_cell.motion.program import Program
from mdms_cell.perception.angle import ROOT_MAX, root
from mdms_cell.perception.belief import Belief
from mdms_protocol.neighbours import frames as wire

ways = st.integers(-3_000_000, 3_000_000)
STEP_MS = 10


@given(ways, ways, ways)
def test_length_is_that_of_the_vector_however_far_it_goes(x, y, z):
    wanted = sqrt(x * x + y * y + z * z)
    assert length(x, y, z) == pytest.approx(wanted, rel=5e-5, abs=1)


REACH_UM = 250_000


def programmed(x=0, y=0, acceleration=255):
    """A steering by a program with a goal [steps of the wire]."""
    program = Program()
    program.take((1, wire.PARCEL, 1, wire.RECTANGLE, 0, 0, acceleration, 255, 0))
    program.take((1, wire.GOAL, 1, x, y, 0, 0, 0, 0))
    steering = Steering()
    steering.read(program)
    return steering


def steered(x, y, beats):
    """The commanded twist after so many beats on the way to a goal [steps of the wire]."""
    steering, parcel = programmed(x, y), Belief()
    parcel.reach_um = REACH_UM
    for _ in range(beats):
        steering.find_wish(parcel, 0, 0)
        steering.approach(parcel.reach_um, True, STEP_MS)
    return steering.commanded


def test_goal_at_the_far_end_of_a_large_table_asks_for_no_root_that_a_board_cannot_take(
    monkeypatch,
):
    asked = []

    def noted(number):
        asked.append(number)
        return root(number)

    monkeypatch.setattr(leading, "root", noted)
    vx, vy, _ = steered(6_000, 5_080, 100)
    assert max(asked) <= ROOT_MAX
    assert hypot(vx, vy) == pytest.approx(1_275_000, rel=5e-3)


def test_goal_beyond_exact_lengths_is_gone_to_as_fast_as_may_be():
    vx, vy, _ = steered(-120_000, 90_000, 100)
    assert vx == pytest.approx(-1_020_000, rel=5e-3)
    assert vy == pytest.approx(765_000, rel=5e-3)


@pytest.mark.parametrize("axis", range(3))
def test_parcel_stands_only_where_no_part_of_its_twist_is_left(axis) -> None:
    steering = programmed()
    assert steering.stands()
    steering.commanded[axis] = 1
    assert not steering.stands()


@pytest.mark.parametrize("acceleration", [0, 1])
@pytest.mark.parametrize("step_ms", [1, STEP_MS])
def test_no_acceleration_makes_a_ramp_that_never_ends(acceleration, step_ms):
    steering = programmed(acceleration=acceleration)
    steering.commanded[0], steering.commanded[1], steering.commanded[2] = 100_000, -50_000, 20_000
    beats = 0
    while not steering.approach(REACH_UM, False, step_ms):
        beats += 1
        assert beats < 2_000
