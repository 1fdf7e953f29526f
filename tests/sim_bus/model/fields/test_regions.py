"""Regions that share a border share no place, and leave none out."""

import itertools

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.fields import inside
from mdms_model.scenario.motion import Region

grid = st.integers(-8, 8).map(lambda n: n * 0.127)
points = st.lists(st.tuples(grid, grid), min_size=1, max_size=30).map(np.array)


@given(points, st.lists(grid, min_size=2, max_size=4, unique=True))
def test_rectangles_side_by_side_partition_the_table(places_m, cuts):
    edges = [-9.0, *sorted(cuts), 9.0]
    tiles = [
        Region("rectangle", corners_m=((left, -9.0), (right, 9.0)))
        for left, right in itertools.pairwise(edges)
    ]
    held = sum(inside(tile, places_m).astype(int) for tile in tiles)
    np.testing.assert_array_equal(held, 1)


@given(points, st.tuples(grid, grid))
def test_triangles_about_a_point_partition_the_table(places_m, middle):
    outer = [(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)]
    tiles = [
        Region("polygon", corners_m=(middle, start, end))
        for start, end in zip(outer, outer[1:] + outer[:1], strict=True)
    ]
    held = sum(inside(tile, places_m).astype(int) for tile in tiles)
    np.testing.assert_array_equal(held, 1)


@pytest.mark.parametrize(
    "corners_m",
    [
        ((-0.3, -0.2), (0.4, -0.3), (0.2, 0.5)),
        ((-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (0.0, -0.1), (-0.4, 0.4)),
        ((0.4, 0.4), (0.4, -0.4), (-0.4, -0.4)),
    ],
    ids=["triangle", "not convex", "clockwise"],
)
def test_polygon_has_the_figures_of_shapely(corners_m):
    places_m = np.random.default_rng(1).uniform(-0.6, 0.6, (2000, 2))
    expected = shapely.contains_xy(shapely.Polygon(corners_m), places_m)
    np.testing.assert_array_equal(
        inside(Region("polygon", corners_m=corners_m), places_m), expected
    )


def test_a_rectangle_may_be_given_by_any_opposite_corners():
    places_m = np.random.default_rng(2).uniform(-0.6, 0.6, (200, 2))
    one = Region("rectangle", corners_m=((-0.1, -0.3), (0.4, 0.2)))
    other = Region("rectangle", corners_m=((0.4, -0.3), (-0.1, 0.2)))
    np.testing.assert_array_equal(inside(one, places_m), inside(other, places_m))


def test_disc_has_the_points_within_its_radius():
    places_m = np.array([[0.1, 0.0], [0.3, 0.0], [0.31, 0.0], [0.1, 0.21]])
    disc = Region("disc", centre_m=(0.1, 0.0), radius_m=0.2)
    assert inside(disc, places_m).tolist() == [True, True, False, False]


def test_no_region_is_the_whole_table():
    assert inside(None, np.zeros((3, 2))).all()
