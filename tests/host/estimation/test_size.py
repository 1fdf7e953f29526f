from math import remainder

import numpy as np
import pytest
from tests.host.estimation.lying import WHEELS, Lying

from mdms_host.estimation.belief import BeliefEvent
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.parcel import Parcel
from mdms_host.estimation.size import rectangles_of, size_of
from mdms_host.layout import Layout

LAYOUT = Layout(9, 6, wheels=WHEELS)
SENSORS_M = LAYOUT.sensor_positions_m.reshape(-1, 2)


@pytest.mark.parametrize("seed", range(30))
def test_sides_are_within_four_deviations_however_a_box_lies(seed: int) -> None:
    random = np.random.default_rng(seed)
    length_m = random.uniform(0.24, 0.45)
    width_m = random.uniform(0.2, length_m)
    pose = random.uniform((-0.1, -0.08, -1.5), (0.1, 0.08, 1.5))
    covered = Rectangle(length_m, width_m).distance_m(SENSORS_M, pose) < 0
    size = size_of(SENSORS_M[covered], SENSORS_M[~covered])
    assert size is not None
    assert abs(size.length_m - length_m) < 4 * size.deviation_m[0]
    assert abs(size.width_m - width_m) < 4 * size.deviation_m[1]


def test_a_region_that_no_rectangle_covers_has_no_size() -> None:
    corner = (SENSORS_M > -0.02).all(axis=1) & (SENSORS_M < 0.3).all(axis=1)
    covered = corner & ~(SENSORS_M > 0.14).all(axis=1)
    assert size_of(SENSORS_M[covered], SENSORS_M[~covered]) is None


def test_rectangles_that_sensors_allow_cover_these_and_no_free_one() -> None:
    covered = Rectangle(0.33, 0.26).distance_m(SENSORS_M, np.array([0.03, -0.02, 0.4])) < 0
    poses, sides_m = rectangles_of(SENSORS_M[covered], SENSORS_M[~covered], 0.4, 200)
    for pose, (length_m, width_m) in zip(poses, sides_m.tolist(), strict=True):
        inside = Rectangle(length_m, width_m).distance_m(SENSORS_M, pose) < 1e-9
        np.testing.assert_array_equal(inside, covered)
    assert np.ptp(poses[:, 2]) > 0.05
    assert (sides_m.min(axis=0) < (0.33, 0.26)).all()
    assert (sides_m.max(axis=0) > (0.33, 0.26)).all()


def test_a_size_is_learned_though_nothing_shows_at_rest_where_two_sides_are() -> None:
    """The box is nearly as wide as the table is."""
    box = Rectangle(0.394, 0.333)
    table = Lying(Layout(6, 3, wheels=WHEELS))
    table.put("box", box, -0.06, -0.001, -0.066)
    table.run(0.25)
    rough = table.tracker.size("unknown-1")
    assert rough is not None
    assert rough.length_m - 0.394 > 0.05
    table.tracker.name("unknown-1", rough.parcel("box"))
    table.run(0.15)
    for twist in ((0.05, 0.0, 0.0), (0.0, 0.04, 0.0), (-0.05, 0.0, 0.0), (0.0, -0.04, 0.0)):
        table.run(1.0, {"box": twist})
    size = table.tracker.size("box")
    assert size is not None
    sides_m = sorted((size.length_m, size.width_m))
    np.testing.assert_allclose(sides_m, [0.333, 0.394], atol=0.002)


def test_a_size_that_is_not_told_is_learned_within_a_millimetre_as_edges_pass() -> None:
    box = Rectangle(0.334, 0.257)
    table = Lying(LAYOUT)
    table.put("box", box, 0.03, -0.02, 0.4)
    table.run(0.25)
    rough = table.tracker.size("unknown-1")
    assert rough is not None
    assert max(rough.deviation_m) > 0.004
    table.tracker.name("unknown-1", rough.parcel("box"))
    table.run(0.15)
    for twist in ((0.04, 0.0, 0.0), (0.0, 0.04, 0.0), (-0.04, -0.04, 0.0), (0.0, 0.0, 0.15)):
        table.run(2.0, {"box": twist})
    size = table.tracker.size("box")
    assert size is not None
    assert abs(size.length_m - 0.334) < 0.001
    assert abs(size.width_m - 0.257) < 0.001
    assert max(size.deviation_m) < 0.001
    assert table.off_m("box") < 0.002
    assert ("box", BeliefEvent.DOUBTFUL) not in table.events()


@pytest.mark.parametrize("off_m", [-0.015, 0.015])
def test_a_size_that_is_told_wrong_widens_the_region_where_the_parcel_is_found(off_m) -> None:
    random = np.random.default_rng(1)
    for _ in range(20):
        pose = random.uniform((-0.1, -0.1, -1.5), (0.1, 0.1, 1.5))
        told = Parcel("box", 0.36 + off_m, 0.30 + off_m, yaw_hint_rad=pose[2], spread_m=0.008)
        table = Lying(LAYOUT, (told,))
        table.put("box", Rectangle(0.36, 0.30), *pose)
        table.run(0.4)
        belief = table.tracker.beliefs(table.now_s, table.now_s)["box"]
        off = belief.pose - pose
        off[2] = remainder(off[2], np.pi)
        # Within four standard deviations.
        assert off @ np.linalg.solve(belief.covariance, off) < 4.0**2
