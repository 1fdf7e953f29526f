import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from mdms_host.estimation.footprint import Rectangle, local_m

POSE = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-4, 4)).map(np.array)
POINT = st.tuples(st.floats(-1, 1), st.floats(-1, 1)).map(lambda point: np.array([point]))
BOTTOM = Rectangle(0.36, 0.30)


def test_distance_is_negative_inside_zero_on_the_edge_and_positive_outside() -> None:
    points_m = np.array([[0.0, 0.0], [0.18, 0.1], [0.2, 0.0], [0.0, -0.25]])
    np.testing.assert_allclose(
        BOTTOM.distance_m(points_m, np.zeros(3)), [-0.15, 0.0, 0.02, 0.10], atol=1e-15
    )


def test_a_quarter_turn_swaps_length_and_width() -> None:
    turned = np.array([0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(BOTTOM.distance_m(np.array([[0.0, 0.18]]), turned), 0.0, atol=1e-15)


@given(POSE, POINT)
def test_slope_of_the_edge_agrees_with_differences(pose: np.ndarray, point_m: np.ndarray) -> None:
    x_m, y_m = np.abs(local_m(point_m, pose))[0]
    # On a crease of the distance there is no derivative.
    assume(min(abs((x_m - 0.18) - (y_m - 0.15)), x_m, y_m) > 1e-4)
    step = 1e-6 * np.eye(3)
    differences = [
        (BOTTOM.distance_m(point_m, pose + d) - BOTTOM.distance_m(point_m, pose - d))[0] / 2e-6
        for d in step
    ]
    distance_m, slope = BOTTOM.edge(point_m[0], pose)
    np.testing.assert_allclose(slope, differences, atol=1e-6)
    np.testing.assert_allclose(distance_m, BOTTOM.distance_m(point_m, pose)[0], atol=1e-12)


@given(POSE, POINT, st.floats(-9, 9))
def test_the_nearest_yaw_looks_the_same(pose: np.ndarray, point_m: np.ndarray, hint: float) -> None:
    yaw_rad = BOTTOM.nearest_yaw_rad(pose[2], hint)
    assert abs(yaw_rad - hint) <= np.pi / 2 + 1e-9
    same = np.array([*pose[:2], yaw_rad])
    np.testing.assert_allclose(
        BOTTOM.distance_m(point_m, same), BOTTOM.distance_m(point_m, pose), atol=1e-9
    )
