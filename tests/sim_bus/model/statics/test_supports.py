from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mdms_model.statics.supports import press

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
