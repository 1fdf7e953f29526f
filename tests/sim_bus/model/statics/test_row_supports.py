import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mdms_model.statics.supports import stretches_of, unloading

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
