import numpy as np
import pytest
from tests.host.estimation.lying import agree, locate

from mdms_host.estimation.footprint import Disc, Rectangle
from mdms_host.estimation.pose.estimator import ParcelEstimator
from mdms_host.estimation.pose.pose_cloud import PoseCloud
from mdms_host.estimation.pose.rolling import Speeds, roll_on
from mdms_host.estimation.presence import Surroundings
from mdms_host.layout import Layout, WheelPlace

LAYOUT = Layout(6, 3, wheels=(WheelPlace(0.0, (0.0, 0.03)), WheelPlace(np.pi / 2, (0.03, 0.0))))
SENSORS_M = LAYOUT.sensors_m
TRUE, TOLD = Rectangle(0.28, 0.22), Rectangle(0.278, 0.218)
GRID = np.array([0.006, 0.006, 0.05])
STEP_S = 0.01


def after_three_edges(seed: int) -> list[np.ndarray]:
    """The errors of the belief of a small box, step by step, on a random way."""
    random = np.random.default_rng(seed)
    low, high = np.array([-0.2, -0.05, -1.5]), np.array([0.2, 0.05, 1.5])
    pose, twist = random.uniform(low, high), random.uniform(-1.0, 1.0, 3) * (0.1, 0.05, 0.6)
    covered = TRUE.distance_m(SENSORS_M, pose) < 0
    estimator = ParcelEstimator(Surroundings(LAYOUT), TOLD)
    found = locate(TOLD, SENSORS_M, covered, float(pose[2]))
    assert found is not None
    estimator.start(0.0, found)
    edges, off = 0, []
    for step in range(1, 81):
        now_s, moving = STEP_S * step, twist * min(1.0, step / 20)
        pose = pose + moving * STEP_S
        roll_on([estimator], now_s, Speeds(LAYOUT.surface_jacobian(*pose[:2]) @ moving))
        now = TRUE.distance_m(SENSORS_M, pose) < 0
        for sensor in np.flatnonzero(now != covered):
            edges += 1
            estimator.edge(now_s, SENSORS_M[sensor], bool(now[sensor]))
        covered = now
        agree(estimator, now_s, covered)
        if edges >= 3:
            assert estimator.pose is not None
            off.append(estimator.pose - pose)
            off[-1][2] = (off[-1][2] + np.pi / 2) % np.pi - np.pi / 2
    return off


SEEDS = (25, 68, 76)


@pytest.mark.parametrize("seed", SEEDS)
def test_first_edges_do_not_turn_the_belief_of_a_small_box_away(seed: int) -> None:
    off = np.array(after_three_edges(seed))
    assert len(off)
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.008
    assert abs(off[:, 2]).max() < np.radians(5.0)


def lying_either_way() -> PoseCloud:
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2]])
    return PoseCloud(TRUE, poses, np.ones(2), GRID / 10)


def on_one_bit(cloud: PoseCloud, at_m: tuple[float, float], covered: bool) -> bool:
    one = np.ones(1, dtype=bool)
    return cloud.on_bits(np.array([at_m]), one & covered, one)


@pytest.mark.parametrize(("covered", "yaw_rad"), [(True, 0.0), (False, np.pi / 2)])
def test_a_sensor_decides_which_way_a_box_lies(covered: bool, yaw_rad: float) -> None:
    cloud = lying_either_way()
    assert not cloud.small
    assert on_one_bit(cloud, (0.125, 0.0), covered)
    assert cloud.mean[2] == pytest.approx(yaw_rad, abs=0.01)


def test_sensors_at_a_parcel_at_rest_count_once() -> None:
    cloud = lying_either_way()
    on_one_bit(cloud, (0.1405, 0.0), True)
    once = cloud.covariance
    for _ in range(50):
        on_one_bit(cloud, (0.1405, 0.0), True)
    np.testing.assert_array_equal(cloud.covariance, once)


def test_a_sensor_that_contradicts_all_poses_is_not_believed_for_as_long_as_it_does() -> None:
    cloud = lying_either_way()
    assert not on_one_bit(cloud, (0.2, 0.2), True)
    assert not on_one_bit(cloud, (0.2, 0.2), True)
    assert on_one_bit(cloud, (0.2, 0.2), False)


def test_an_edge_leaves_the_poses_that_have_it() -> None:
    cloud = lying_either_way()
    cloud.on_edge(np.array([0.14, 0.0]), 0.0)
    assert cloud.mean[2] == pytest.approx(0.0, abs=0.01)


def test_a_disc_keeps_its_yaw_and_how_little_is_known_of_it() -> None:
    disc = Disc(0.3)
    poses = np.array([[x_m, 0.0, 0.7] for x_m in np.arange(-0.03, 0.03, 0.006)])
    cloud = PoseCloud(disc, poses, np.ones(len(poses)), GRID)
    assert not cloud.small
    for point_m in ((0.15, 0.0), (0.0, 0.15), (-0.15, 0.0)):
        cloud.on_edge(np.array(point_m), 0.0)
    assert cloud.mean[2] == 0.7
    assert cloud.covariance[2, 2] == pytest.approx(GRID[2] ** 2 / 3)
    assert cloud.small
