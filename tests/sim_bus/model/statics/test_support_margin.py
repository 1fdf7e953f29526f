"""How far inside the hull of its supports a parcel's centre of mass is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.array import build_wheels
from mdms_model.outline import outline_of
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Parcel
from mdms_model.statics.support_margin import support_margin_m, support_margins_m
from mdms_model.statics.supports import press

MIDDLE = (0.0, 0.0)
PITCH_M = 0.127


def box(length_m, width_m, shape="rectangle", corners_m=()):
    return outline_of(Parcel("box", 2.0, length_m, width_m, shape=shape, corners_m=corners_m))


def wheels_of(name, *overrides):
    return build_wheels(load_scenario(name, list(overrides))).position_m


@pytest.fixture(scope="module")
def table():
    """The prototype's cells, and enough of them to have no ends."""
    return wheels_of("array18", "array.columns=9", "array.rows=9")


@pytest.fixture(scope="module")
def somewhere():
    """Poses over one cell and all turns by which a rectangle looks different."""
    places_m = np.linspace(-PITCH_M / 2, PITCH_M / 2, 25)
    grid = np.meshgrid(places_m, places_m, np.linspace(0.0, np.pi, 60, endpoint=False))
    return np.stack(grid, axis=-1).reshape(-1, 3)


@pytest.mark.parametrize(
    ("length_m", "width_m", "measured_m"),
    [(0.25, 0.20, -0.026), (0.28, 0.28, 0.014), (0.36, 0.30, 0.026), (0.30, 0.30, 0.026)],
)
def test_least_margin_over_all_poses_is_the_reach_of_the_short_side_past_a_pitch(
    table, somewhere, length_m, width_m, measured_m
):
    least_m = support_margins_m(table, box(length_m, width_m), MIDDLE, somewhere).min()
    exact_m = width_m / 2 - PITCH_M
    assert exact_m <= least_m <= exact_m + PITCH_M / 24
    assert least_m == pytest.approx(measured_m, abs=0.003)


def test_margin_is_the_way_to_the_nearest_side_of_the_hull():
    square = np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1], [0.0, 0.0]])
    wide = box(0.6, 0.6)
    assert support_margin_m(square, wide, MIDDLE, (0.0, 0.0, 0.3)) == pytest.approx(0.1)
    assert support_margin_m(square, wide, MIDDLE, (0.07, -0.02, 0.3)) == pytest.approx(0.03)
    assert support_margin_m(square, wide, MIDDLE, (0.0, 0.12, 0.0)) == pytest.approx(-0.02)


def test_a_centre_of_mass_beside_the_middle_counts_as_it_is_turned():
    square = np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]])
    quarter = (0.0, 0.02, np.pi / 2)
    assert support_margin_m(square, box(0.6, 0.6), (0.05, 0.0), quarter) == pytest.approx(0.03)


def test_two_supports_hold_nothing_and_none_hold_less():
    pair = np.array([[-0.1, 0.0], [0.1, 0.0], [5.0, 5.0]])
    assert support_margin_m(pair, box(0.4, 0.1), MIDDLE, (0.0, 0.0, 0.0)) == pytest.approx(0.0)
    assert support_margin_m(pair, box(0.4, 0.1), MIDDLE, (0.0, 0.03, 0.0)) == pytest.approx(-0.03)
    assert support_margin_m(pair, box(0.4, 0.1), MIDDLE, (1.0, 0.0, 0.0)) == -np.inf


def test_on_a_row_the_way_along_it_counts():
    row = wheels_of("paper-fig7")
    box_m = box(0.4445, 0.10)
    assert support_margin_m(row, box_m, MIDDLE, (0.0, 0.0, 0.0)) == pytest.approx(1.5 * PITCH_M)
    assert support_margin_m(row, box_m, MIDDLE, (0.0, 0.01, 0.0)) == pytest.approx(-0.01)
    column = row[:, ::-1]
    assert support_margin_m(column, box_m, MIDDLE, (0.0, 0.0, np.pi / 2)) == pytest.approx(
        1.5 * PITCH_M
    )


def test_discs_and_polygons_cover_the_points_under_them(table):
    disc = box(0.30, 0.30, "disc")
    triangle = box(0.30, 0.30, "polygon", ((0.15, -0.15), (0.0, 0.15), (-0.15, -0.15)))
    square = box(0.30, 0.30)
    poses = np.array([[0.0, 0.02, 0.1], [0.03, 0.01, 0.4], [-0.05, 0.06, 1.2]])
    whole_m = support_margins_m(table, square, MIDDLE, poses)
    for part in (disc, triangle):
        assert (support_margins_m(table, part, MIDDLE, poses) <= whole_m + 1e-12).all()


POSE = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.floats(-4.0, 4.0))


@given(POSE, st.sampled_from(["rectangle", "disc"]))
def test_a_parcel_has_a_margin_where_eq_1_balances_its_weight(pose, shape):
    wheel_m = wheels_of("array18")
    outline = box(0.26, 0.26, shape)
    margin_m = support_margin_m(wheel_m, outline, MIDDLE, pose)
    if abs(margin_m) < 1e-5:
        return
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    own_m = (wheel_m - pose[:2]) @ np.array([[cosine, -sine], [sine, cosine]])
    under = np.hypot(*own_m.T) <= outline.radius_m
    for along, across, distance_m, *_ in outline.edges:
        under &= own_m @ (along, across) <= distance_m
    spot_m = np.ascontiguousarray(wheel_m[under] - pose[:2])
    assert press(spot_m, 20.0, np.empty(len(spot_m))) == (margin_m > 0.0)
