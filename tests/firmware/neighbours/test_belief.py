"""Where a cell believes its parcel to be, in whole numbers, against closed forms."""

from math import cos, degrees, hypot, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.firmware.neighbours.some_place import SomePlace

from mdms_cell.perception.angle import ARM_UM, ONE, TURN_UM, root, turn_um, wrapped, yaw
from mdms_cell.perception.belief import CONTRADICTION, EDGE, Belief
from mdms_cell.perception.footprint import MARGIN, OWN, Footprint
from mdms_cell.perception.outline import COSINE, DISC, RECTANGLE, SINE, STEP_UM, Outline
from mdms_cell.perception.place import AXES, SENSORS
from mdms_cell.perception.sensors import Comparison
from mdms_protocol.neighbours import frames as wire

SMALL_INT = 1 << 30
SENSORS_MASK = (1 << SENSORS) - 1
POINTS_MASK = (1 << AXES + SENSORS) - 1
LENGTH_UM, WIDTH_UM = 360_000, 300_000
places = st.integers(-500_000, 500_000)
turns = st.integers(-TURN_UM // 2, TURN_UM // 2)


@given(turns)
def test_sine_and_cosine_are_those_of_the_angle(turn_um):
    angle_rad = turn_um / ARM_UM
    registers = outline(turn_um=turn_um).registers
    cosine, sine = registers[COSINE], registers[SINE]
    assert abs(sine - ONE * sin(angle_rad)) < 3
    assert abs(cosine - ONE * cos(angle_rad)) < 3


@given(st.integers(0, SMALL_INT - 1))
def test_root_is_the_largest_whole_number_below(number):
    assert root(number) ** 2 <= number < (root(number) + 1) ** 2


@given(st.integers(-SMALL_INT + 1, SMALL_INT - 1))
def test_wrapped_angle_looks_the_same(turn_um):
    assert -TURN_UM // 2 <= wrapped(turn_um) <= TURN_UM // 2
    assert (wrapped(turn_um) - turn_um) % TURN_UM == 0


def outline(shape=RECTANGLE, *, x_um=0, y_um=0, turn_um=0):
    one = Outline()
    one.set(shape, LENGTH_UM, WIDTH_UM)
    one.place(x_um, y_um, turn_um)
    return one


@given(places, places, turns, places, places)
def test_distance_is_that_to_the_nearest_side(x_um, y_um, turn_um, at_x, at_y):
    found = outline(x_um=x_um // 8, y_um=y_um // 8, turn_um=turn_um)
    dx, dy, angle_rad = at_x - x_um // 8, at_y - y_um // 8, turn_um / ARM_UM
    along = abs(dx * cos(angle_rad) + dy * sin(angle_rad)) - LENGTH_UM / 2
    across = abs(dy * cos(angle_rad) - dx * sin(angle_rad)) - WIDTH_UM / 2
    wanted_um = max(along, across)
    got_um = found.edge(at_x // STEP_UM, at_y // STEP_UM) * STEP_UM
    assert got_um == pytest.approx(wanted_um, abs=400)


def overlaps(found, x, y, half):
    footprint = Footprint(SomePlace())
    footprint.shifts[2 * OWN], footprint.shifts[2 * OWN + 1], footprint.half = x, y, half
    return footprint.reaches(found)


@given(places, places, turns)
def test_square_that_a_point_of_the_bottom_lies_in_is_overlapped(along, across, turn_um):
    """Wherever a point of the bottom is, a square about it is overlapped."""
    found = outline(turn_um=turn_um)
    along, across = along * LENGTH_UM // 1_000_100, across * WIDTH_UM // 1_000_100
    angle_rad = turn_um / ARM_UM
    x = along * cos(angle_rad) - across * sin(angle_rad)
    y = along * sin(angle_rad) + across * cos(angle_rad)
    assert overlaps(found, int(x) // STEP_UM, int(y) // STEP_UM, 100)


@given(
    st.sampled_from([RECTANGLE, DISC]),
    places,
    turns,
    st.tuples(places, places),
    st.integers(-10_000, 10_000),
)
def test_points_within_a_limit_are_no_farther_outside(shape, x_um, turn_um, at_um, limit_um):
    x_um, y_um = x_um // 4, x_um // 5
    found = outline(shape, x_um=x_um, y_um=y_um, turn_um=turn_um)
    footprint = Footprint(SomePlace([at_um] * (AXES + SENSORS)))
    dx, dy, angle_rad = at_um[0] - x_um, at_um[1] - y_um, turn_um / ARM_UM
    along = abs(dx * cos(angle_rad) + dy * sin(angle_rad)) - LENGTH_UM / 2
    across = abs(dy * cos(angle_rad) - dx * sin(angle_rad)) - WIDTH_UM / 2
    outside_um = max(along, across) if shape == RECTANGLE else hypot(dx, dy) - LENGTH_UM / 2
    mask = footprint.within(found, OWN, limit_um // STEP_UM)
    if abs(outside_um - limit_um) > 400:
        assert mask == (POINTS_MASK if outside_um < limit_um else 0)


@given(
    st.sampled_from([RECTANGLE, DISC]), places, turns, places, places, st.integers(0, SENSORS_MASK)
)
def test_sensors_are_compared_with_the_outline_at_each_limit(  # noqa: PLR0917
    shape, x_um, turn_um, at_x, at_y, bits
):
    found = outline(shape, x_um=x_um // 4, y_um=x_um // 5, turn_um=turn_um)
    points_um = [(at_x * number // 6, at_y * number // 6) for number in range(AXES + SENSORS)]
    footprint = Footprint(SomePlace(points_um))

    def within(limit):
        return footprint.within(found, OWN, limit)

    deep, far = within(-625) >> AXES, SENSORS_MASK & ~(within(626) >> AXES)
    got = Comparison()
    got.find(found, footprint, OWN, bits)
    assert got.wrong == within(0) >> AXES ^ bits
    assert got.missing == bool(deep and not deep & bits)
    assert got.far == bool(far & bits)
    assert got.clearly == bool(deep or far)
    assert got.nearly == bool(within(MARGIN))


@pytest.mark.parametrize("shape", [RECTANGLE, DISC])
@pytest.mark.parametrize("away", [(1, 0), (0, 1), (1, 1), (-1, 1)])
def test_square_beyond_a_gap_is_not_overlapped(shape, away):
    reach = outline(shape).reach_um // STEP_UM
    half = 4000
    x, y = (each * (reach + half + 100) for each in away)
    assert not overlaps(outline(shape), x, y, half)


def crossing(belief, truth, sensor_um):
    """The sensor reports an edge of the parcel that is truly there."""
    return belief.correct(sensor_um[0] // STEP_UM, sensor_um[1] // STEP_UM, EDGE)


def believing(x_um, y_um, turn_um):
    belief = Belief()
    belief.set(RECTANGLE, LENGTH_UM, WIDTH_UM)
    belief.start(x_um, y_um, turn_um)
    return belief


def roll(belief, dx_um, dy_um, dturn_um):
    """The parcel goes so far in a second, as fast as in the one before."""
    speeds = dx_um, dy_um, dturn_um
    for axis, speed in enumerate(speeds):
        belief.twist.speeds[axis] = belief.twist.before[axis] = speed
    belief.roll(1_000)
    belief.move_outline()


@given(st.integers(-8000, 8000), st.integers(-8000, 8000), st.integers(-4000, 4000))
def test_three_edges_show_where_a_parcel_is(x_um, y_um, turn_um):
    """Two on one side and one on the next, seen twice, of a parcel that truly is at 0."""
    belief = believing(x_um, y_um, turn_um)
    sides = ((180_000, -90_000), (180_000, 100_000), (60_000, 150_000))
    for sensor_um in sides + sides:
        crossing(belief, (0, 0, 0), sensor_um)
    assert hypot(*belief.pose[:2]) < 1_500
    assert degrees(abs(belief.pose[2]) / ARM_UM) < 0.8


@given(st.integers(-3000, 3000), st.integers(-60_000, 60_000), st.integers(-60_000, 60_000))
def test_edge_changes_the_covariance_as_the_kalman_filter_does(turn_um, along_um, across_um):
    """P - (P h)(P h)' / (h' P h + r), after two edges that tie x, y and yaw together."""
    belief = believing(0, 0, turn_um)
    for sensor_um in ((180_000, along_um), (across_um, 150_000)):
        assert crossing(belief, (0, 0, 0), sensor_um)
    xx, yy, tt, xy, xt, yt = belief.covariance
    before = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]], float)
    assert belief.variance() == (xx + yy + tt) // 3
    assert crossing(belief, (0, 0, 0), (-180_000, along_um))
    h = np.array(belief.normal) / 1024
    gain = before @ h / (h @ before @ h + EDGE)
    after = before - np.outer(gain, before @ h)
    xx, yy, tt, xy, xt, yt = belief.covariance
    found = [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]
    assert np.allclose(found, after, rtol=0.02, atol=30)


def test_edge_far_away_is_not_believed_but_makes_unsure():
    belief = believing(0, 0, 0)
    for sensor_um in ((180_000, -90_000), (180_000, 100_000), (60_000, 150_000)):
        crossing(belief, (0, 0, 0), sensor_um)
    assert crossing(belief, (0, 0, 0), (180_000, 0))
    before = belief.variance()
    assert not crossing(belief, (0, 0, 0), (150_000, 0))
    assert belief.pose.tolist() == pytest.approx([0, 0, 0], abs=50)
    assert belief.variance() > before


def test_contradiction_moves_the_belief_and_makes_it_no_surer():
    belief = believing(5_000, 0, 0)
    before = belief.variance()
    belief.correct(182_000 // STEP_UM, 0, CONTRADICTION, False)
    assert belief.pose[0] < 3_500
    assert belief.variance() == before


def test_way_makes_unsure_and_standing_does_not():
    belief = believing(0, 0, 0)
    for sensor_um in ((180_000, -90_000), (180_000, 100_000), (60_000, 150_000)):
        crossing(belief, (0, 0, 0), sensor_um)
    before = belief.variance()
    for _ in range(100):
        roll(belief, 0, 0, 0)
    assert belief.variance() == before
    for _ in range(100):
        roll(belief, 1_000, 0, 0)
    assert belief.pose[0] == pytest.approx(100_000, abs=100)
    assert belief.variance() > before


def test_agreement_meets_between_beliefs_and_is_no_surer_than_both():
    belief = believing(0, 0, 0)
    before = belief.variance()
    off = [100 * each // 4 for each in (2_000, -1_000, 500)]
    belief.agree(off, 100 * (before // 4), weight=100, own_weight=100)
    assert belief.pose.tolist() == [1_000, -500, 250]
    assert before // 4 < belief.variance() < before


@given(st.lists(st.tuples(places, places), max_size=40), places, places, turns)
def test_numbers_stay_small_whatever_sensors_say(sensors_um, x_um, y_um, turn_um):
    """On a board a number above 2^30 allocates."""
    belief = believing(x_um, y_um, turn_um)
    for at_um in sensors_um:
        belief.correct(at_um[0] // STEP_UM, at_um[1] // STEP_UM, EDGE)
        roll(belief, 4_000, -4_000, 2_000)
        numbers = belief.covariance  # variances come first
        assert max(map(abs, numbers)) < 1 << 19
        assert min(numbers[:3]) > 0
        assert max(map(abs, belief.pose[:2])) < 2_000_000


def test_full_turn_is_a_full_turn():
    assert abs(TURN_UM - 2 * pi * ARM_UM) < 1


@given(st.integers(-wire.TURN // 2, wire.TURN // 2))
def test_angle_of_the_wire_comes_back_from_the_way_at_the_arm(angle):
    assert yaw(turn_um(angle)) == angle
