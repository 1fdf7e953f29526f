import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tests.host.estimation.lying import locate

from mdms_host.estimation.footprint import Disc
from mdms_host.estimation.pose.estimator import ParcelEstimator
from mdms_host.estimation.pose.rolling import Speeds, roll_on
from mdms_host.estimation.presence import Surroundings
from mdms_host.layout import Layout, WheelPlace

LAYOUT = Layout(6, 3, wheels=(WheelPlace(0.0, (-0.03, 0.0)), WheelPlace(np.pi / 2, (0.03, 0.0))))
SENSORS_M = LAYOUT.sensor_positions_m.reshape(-1, 2)
DISC = Disc(0.30)
POSE = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-4, 4)).map(np.array)
POINT = st.tuples(st.floats(-1, 1), st.floats(-1, 1)).map(lambda point: np.array([point]))


def test_distance_is_negative_inside_zero_on_the_rim_and_positive_outside() -> None:
    points_m = np.array([[0.1, 0.0], [0.19, 0.12], [0.1, -0.2]])
    pose = np.array([0.1, 0.0, 0.7])
    np.testing.assert_allclose(DISC.distance_m(points_m, pose), [-0.15, 0.0, 0.05], atol=1e-15)


@given(POSE, POINT)
def test_slope_of_the_rim_agrees_with_differences(pose: np.ndarray, point_m: np.ndarray) -> None:
    assume(np.hypot(*(point_m[0] - pose[:2])) > 1e-3)
    differences = [
        (DISC.distance_m(point_m, pose + d) - DISC.distance_m(point_m, pose - d))[0] / 2e-6
        for d in 1e-6 * np.eye(3)
    ]
    distance_m, slope = DISC.edge(point_m[0], pose)
    np.testing.assert_allclose(slope, differences, atol=1e-3)
    np.testing.assert_allclose(distance_m, DISC.distance_m(point_m, pose)[0], atol=1e-12)


def test_a_disc_grows_by_the_mean_of_both_directions_on_either_side() -> None:
    grown = Disc(0.20).grown(0.01, 0.03)
    assert isinstance(grown, Disc)
    assert abs(grown.diameter_m - 0.24) < 1e-12


def test_a_sensor_right_under_the_centre_has_no_direction() -> None:
    distance_m, slope = DISC.edge(np.zeros(2), np.zeros(3))
    assert distance_m == -0.15
    np.testing.assert_array_equal(slope, np.zeros(3))


@settings(deadline=None)
@given(st.floats(-0.2, 0.2), st.floats(-0.04, 0.04), st.floats(-3, 3))
def test_a_disc_is_found_with_the_yaw_of_the_hint(x: float, y: float, hint: float) -> None:
    covered = DISC.distance_m(SENSORS_M, np.array([x, y, 0.0])) < 0
    found = locate(DISC, SENSORS_M, covered, hint)
    assert found is not None
    assert np.hypot(*(found.pose[:2] - (x, y))) < 0.025
    assert abs(found.pose[2] - hint) < 1e-9


def test_edges_correct_the_place_of_a_disc_and_never_its_yaw() -> None:
    estimator, twist = ParcelEstimator(Surroundings(LAYOUT), DISC), np.array([0.08, 0.01, 0.3])
    pose = np.array([-0.15, 0.0, 0.0])
    covered = DISC.distance_m(SENSORS_M, pose) < 0
    found = locate(DISC, SENSORS_M, covered)
    assert found is not None
    estimator.start(0.0, found)
    for step in range(1, 300):
        pose = pose + twist * 0.01
        roll_on([estimator], 0.01 * step, Speeds(LAYOUT.surface_jacobian(*pose[:2]) @ twist * 0.95))
        now = DISC.distance_m(SENSORS_M, pose) < 0
        for sensor in np.flatnonzero(now != covered):
            yaw_rad = estimator.pose[2]
            estimator.edge(0.01 * step, SENSORS_M[sensor], bool(now[sensor]))
            assert estimator.pose[2] == yaw_rad
        covered = now
    assert np.hypot(*(estimator.pose - pose)[:2]) < 0.005
