from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.motion.trajectory.path import Path

REACH_M = 0.2
POSE = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3))
POSES = st.lists(POSE, min_size=1, max_size=5).map(np.array)
SHARE = st.floats(0.0, 1.0)


@given(POSES, SHARE, SHARE)
def test_the_path_coordinate_is_the_way_of_centre_and_corner(
    poses: np.ndarray, one: float, other: float
) -> None:
    path = Path(poses, REACH_M)
    low_m, high_m = sorted((one * path.length_m, other * path.length_m))
    away_m = path.distance_m(path.pose_at(high_m) - path.pose_at(low_m))
    assert away_m <= high_m - low_m + 1e-9
    if path.piece_at(low_m) is path.piece_at(high_m):
        assert away_m == pytest.approx(high_m - low_m, abs=1e-9)


@given(POSES, SHARE)
def test_a_pose_on_the_path_is_found_where_it_is(poses: np.ndarray, share: float) -> None:
    path = Path(poses, REACH_M)
    pose = path.pose_at(share * path.length_m)
    nearest_m = path.nearest_m(pose, 0.0, path.length_m)
    np.testing.assert_allclose(path.pose_at(nearest_m), pose, atol=1e-6)


def test_a_pose_beside_the_path_is_found_square_to_it_within_the_bounds() -> None:
    path = Path(np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0)]), REACH_M)
    beside = np.array([0.9, 0.3, 0.0])
    assert path.nearest_m(beside, 0.0, 2.0) == pytest.approx(1.3)
    assert path.nearest_m(beside, 0.0, 1.0) == pytest.approx(0.9)
    assert path.nearest_m(beside, 0.0, 0.5) == pytest.approx(0.5)


def test_pieces_of_one_direction_are_one_and_poses_that_coincide_too() -> None:
    poses = [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), (0.3, 0.0, 0.0), (0.3, 0.1, 0.0)]
    path = Path(np.array(poses), REACH_M)
    assert path.corners_m == pytest.approx((0.3, 0.4))


def test_a_path_of_one_pose_has_no_length() -> None:
    path = Path(np.array([(0.1, 0.2, 0.3)]), REACH_M)
    assert path.length_m == 0.0
    np.testing.assert_array_equal(path.end, (0.1, 0.2, 0.3))
    assert not path.direction_at(0.0).any()


@pytest.mark.parametrize("poses", [np.zeros((0, 3)), np.zeros(3), np.array([(0.0, 0.0, np.nan)])])
def test_a_bad_path_is_refused(poses: np.ndarray) -> None:
    with pytest.raises(ValueError, match="finite poses"):
        Path(poses, REACH_M)


def test_a_leg_that_might_as_well_turn_the_other_way_round_is_two() -> None:
    half = Path(np.array([(0.0, 0.0, 1.0), (0.2, 0.0, 1.0 + pi)]), REACH_M)
    assert half.legs_m == pytest.approx((half.length_m / 2, half.length_m))
    less = Path(np.array([(0.0, 0.0, 1.0), (0.2, 0.0, 3.8), (0.2, 0.1, 3.8)]), REACH_M)
    assert less.legs_m == less.corners_m
