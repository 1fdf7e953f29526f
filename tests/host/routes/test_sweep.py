"""Tiles that a moving outline meets, against points of the outline all along its way."""

import numpy as np
import pytest

from mdms_host.estimation.footprint import Disc, Footprint, Polygon, Rectangle
from mdms_host.layout import Layout
from mdms_host.routes.grid import Tiles
from mdms_host.routes.route import TrapezoidPace
from mdms_host.routes.support import Shape
from mdms_host.routes.sweep import PIECE_RAD, swept

SIDE_M = 0.05
WEDGE = Polygon(np.array([[-0.09, -0.07], [0.11, -0.02], [0.02, 0.08]]))
FOOTPRINTS = {"box": Rectangle(0.28, 0.16), "disc": Disc(0.2), "wedge": WEDGE}
#: Times of a way at which an outline is looked at, and points of it.
MOMENTS, POINTS = 101, 2000


def ways(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A start and an end, with turns of more than a piece, and to either side."""
    drawn = np.random.default_rng(seed)
    start = drawn.uniform((-0.1, -0.1, -3.0), (0.1, 0.1, 3.0))
    return start, start + drawn.uniform((-0.2, -0.2, -0.5), (0.2, 0.2, 0.5))


def tiles_under(
    points_m: np.ndarray, start: np.ndarray, end: np.ndarray
) -> list[set[tuple[int, int]]]:
    """The tiles under points of the outline at each moment of a way."""
    found = []
    for share in np.linspace(0.0, 1.0, MOMENTS):
        x_m, y_m, yaw_rad = start + share * (end - start)
        cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
        there_m = points_m @ np.array([[cosine, sine], [-sine, cosine]]) + (x_m, y_m)
        found.append({(int(x), int(y)) for x, y in np.floor(there_m / SIDE_M)})
    return found


def inner_points_m(footprint: Footprint, seed: int) -> np.ndarray:
    """Points of an outline, and its corners, a little inside."""
    drawn = np.random.default_rng(seed).uniform(-0.2, 0.2, (8 * POINTS, 2))
    within_m = drawn[footprint.distance_m(drawn, np.zeros(3)) < 0.0][:POINTS]
    corners_m = footprint.outline_m(np.zeros(3))
    return np.vstack((within_m, 0.9999 * corners_m))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", FOOTPRINTS)
def test_every_point_of_an_outline_is_over_a_tile_that_is_met_at_that_moment(name, seed):
    footprint = FOOTPRINTS[name]
    start, end = ways(seed)
    body = Shape(footprint).body
    met = swept(body, start, end, 0.0, SIDE_M)
    times = {
        (int(column), int(row)): (enters, leaves)
        for (column, row), enters, leaves in zip(met.places, met.enters, met.leaves, strict=True)
    }
    under = tiles_under(inner_points_m(footprint, seed), start, end)
    for share, tiles in zip(np.linspace(0.0, 1.0, MOMENTS), under, strict=True):
        for tile in tiles:
            enters, leaves = times[tile]
            assert enters - 1e-9 <= share <= leaves + 1e-9
    # When a tile begins and ends to be met, the outline is there, up to what a turn adds.
    steps_m = np.linspace(0.0, SIDE_M, 21)
    tile_m = np.stack(np.meshgrid(steps_m, steps_m), axis=-1).reshape(-1, 2)
    for tile, its_times in times.items():
        for share in its_times:
            pose = start + share * (end - start)
            near_m = footprint.distance_m(tile_m + np.array(tile) * SIDE_M, pose).min()
            assert near_m < 0.002 + 2 * body.bend_m * PIECE_RAD / 2


def test_the_middles_of_a_cells_tiles_are_about_its_own() -> None:
    layout = Layout(4, 3)
    tiles = Tiles(layout)
    for number, centre_m in enumerate(layout.cell_positions_m, 1):
        middles_m = [tiles.centre_m(tile) for tile in tiles.of_cell(number).tolist()]
        assert np.mean(middles_m, axis=0) == pytest.approx(centre_m)
        assert {tiles.cell_of(tile) for tile in tiles.of_cell(number).tolist()} == {number}


def test_a_short_move_speeds_up_over_half_its_way_and_brakes_over_the_other():
    pace = TrapezoidPace(speed_m_s=0.2, acceleration_m_s2=0.5)
    lengths_m, turns_m = np.array([0.03, 0.4]), np.array([0.04, 0.3])
    half_s, end_s = np.sqrt(0.05 / 0.5), 2 * np.sqrt(0.05 / 0.5)
    short = [pace.times_s(lengths_m[:1], turns_m[:1], np.array([share]))[0] for share in (0.5, 1)]
    assert short == pytest.approx([half_s, end_s])
    # 0.5 m: 0.04 m and 0.4 s of either ramp, and the rest at 0.2 m/s.
    long = [
        pace.times_s(lengths_m[1:], turns_m[1:], np.array([share]))[0]
        for share in (0.08, 0.5, 0.92, 1)
    ]
    assert long == pytest.approx([0.4, 1.45, 2.5, 2.9])
