from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mdms_model.statics.supports import press, stretches_of, unloading

WEIGHT_N = 20.0
places = st.integers(-40, 40).map(lambda step: step / 100)
spots = st.lists(st.tuples(places, places), min_size=1, max_size=7, unique=True)


def pressed(spots_m):
    spots_m = np.array(spots_m, dtype=float)
    normal_n = np.empty(len(spots_m))
    stands = press(spots_m, WEIGHT_N, normal_n)
    return stands, normal_n


def least_squares(spots_m):
    """Eq (1) with a plane: N = B^T (B B^T)^-1 [W, 0, 0], by the pseudo-inverse."""
    rows = np.column_stack([np.ones(len(spots_m)), spots_m]).T
    return np.linalg.pinv(rows) @ [WEIGHT_N, 0.0, 0.0]


def least_squares_without_pull(spots_m):
    """The least sum of squares among all choices of carrying supports; None if none balances."""
    best = None
    for size in range(1, len(spots_m) + 1):
        for chosen in map(list, combinations(range(len(spots_m)), size)):
            rows = np.column_stack([np.ones(size), spots_m[chosen]]).T
            normal_n = np.zeros(len(spots_m))
            normal_n[chosen] = np.linalg.pinv(rows) @ [WEIGHT_N, 0.0, 0.0]
            balances = np.allclose(rows @ normal_n[chosen], [WEIGHT_N, 0.0, 0.0], atol=1e-9)
            pushes = balances and (normal_n > -1e-9).all()
            if pushes and (best is None or (normal_n**2).sum() < (best**2).sum()):
                best = normal_n
    return best


def test_a_row_carries_as_equation_1_says():
    x = np.array([-0.2, -0.08, 0.04, 0.16])
    stands, normal_n = pressed(np.column_stack([x, np.zeros(4)]))
    rows = np.array([np.ones(4), x])
    assert stands
    assert normal_n == pytest.approx(rows.T @ np.linalg.inv(rows @ rows.T) @ [WEIGHT_N, 0.0])


def test_a_plane_of_supports_carries_as_the_pseudo_inverse_says():
    spots_m = np.array([[-0.1, -0.1], [0.15, -0.1], [-0.1, 0.12], [0.1, 0.1], [0.0, 0.05]])
    stands, normal_n = pressed(spots_m)
    assert stands
    assert normal_n == pytest.approx(least_squares(spots_m))


@given(spots)
def test_no_support_pulls_and_the_sum_of_squares_is_the_least(spots_m):
    spots_m = np.array(spots_m)
    expected = least_squares_without_pull(spots_m)
    stands, normal_n = pressed(spots_m)
    assert (normal_n >= 0.0).all()
    assert stands == (expected is not None)
    if stands:
        assert normal_n == pytest.approx(expected, abs=1e-6)
        assert normal_n.sum() == pytest.approx(WEIGHT_N)
        assert normal_n @ spots_m == pytest.approx(0.0, abs=1e-5)


@given(spots, st.floats(0.0, 6.3))
def test_turning_the_table_changes_no_force(spots_m, angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    stands, normal_n = pressed(spots_m)
    assume(stands)
    assert pressed(np.array(spots_m) @ turn.T)[1] == pytest.approx(normal_n, abs=1e-6)


def test_one_support_under_the_centre_of_mass_carries_all():
    assert pressed([[0.0, 0.0]]) == (True, pytest.approx([WEIGHT_N]))


def test_two_supports_share_by_their_levers():
    stands, normal_n = pressed([[-0.1, -0.2], [0.05, 0.1]])
    assert stands
    assert normal_n == pytest.approx([WEIGHT_N / 3, WEIGHT_N * 2 / 3])


@pytest.mark.parametrize(
    "spots_m",
    [
        np.zeros((0, 2)),
        [[0.01, 0.0]],
        [[-0.1, 0.01], [0.1, 0.01]],
        [[0.01, -0.1], [0.01, 0.1], [0.2, 0.0]],
    ],
)
def test_a_centre_of_mass_beyond_the_supports_does_not_stand(spots_m):
    assert not pressed(np.reshape(spots_m, (-1, 2)))[0]


PITCH_M = 0.127
WHEELS_M = (np.arange(10) - 4.5) * PITCH_M
LENGTHS = st.floats(0.6 * PITCH_M, 8.0 * PITCH_M)
PARTS = st.floats(0.0, 1.0)


def line(places_m, com_x_m, at_m):
    """Eq (1), for a unit weight."""
    arm_m = places_m - places_m.mean()
    return 1 / len(places_m) + (com_x_m - places_m.mean()) * (at_m - places_m.mean()) / (
        arm_m @ arm_m
    )


@given(length_m=LENGTHS, offset=st.floats(-0.45, 0.45), part=PARTS)
def test_supports_balance_the_weight_and_none_pulls(length_m, offset, part):
    com_m = offset * length_m
    stretches = stretches_of(WHEELS_M, (-length_m / 2, length_m / 2), com_m)
    x_m = -0.6 + 1.2 * part
    assume(abs(stretches.edge_m - x_m).min() > 1e-7)
    k = np.searchsorted(stretches.edge_m, x_m) - 1
    covered = np.flatnonzero(abs(WHEELS_M - x_m) <= length_m / 2)
    com_x_m = x_m + com_m
    around = len(covered) and WHEELS_M[covered[0]] < com_x_m < WHEELS_M[covered[-1]]
    supported = 0 <= k < len(stretches.first) and stretches.first[k] <= stretches.last[k]
    assert supported == bool(around)
    if not supported:
        return
    carrying = np.arange(stretches.first[k], stretches.last[k] + 1)
    assert set(carrying) <= set(covered)
    places_m = WHEELS_M[carrying]
    assert (line(places_m, com_x_m, places_m) >= -1e-12).all()
    lifted = np.setdiff1d(covered, carrying)
    assert (line(places_m, com_x_m, WHEELS_M[lifted]) <= 1e-12).all()


def test_paper_parcel_rests_on_three_or_four_wheels():
    stretches = stretches_of(WHEELS_M, (-1.75 * PITCH_M, 1.75 * PITCH_M), 0.0)
    inside = abs(stretches.edge_m[:-1]) < 0.3
    assert set((stretches.last - stretches.first + 1)[inside]) == {3, 4}


def test_length_of_whole_pitches_makes_no_stretch_of_no_width():
    stretches = stretches_of(WHEELS_M, (-1.5 * PITCH_M, 1.5 * PITCH_M), 0.0)
    assert (np.diff(stretches.edge_m) > 0.9e-3).all()


def test_wheels_need_not_be_evenly_spaced():
    wheels_m = np.array([0.0, 0.1, 0.35, 0.4])
    stretches = stretches_of(wheels_m, (-0.5, 0.5), 0.0)
    k = np.searchsorted(stretches.edge_m, 0.2) - 1
    assert (stretches.first[k], stretches.last[k]) == (0, 3)


@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_unloaded_end_follows_from_eq_1(count):
    com_x_m = unloading(WHEELS_M, 0, count - 1, 0)
    assert line(WHEELS_M[:count], com_x_m, WHEELS_M[0]) == pytest.approx(0.0, abs=1e-14)
