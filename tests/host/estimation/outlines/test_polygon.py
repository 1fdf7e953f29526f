import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tests.host.estimation.lying import locate

from mdms_host.estimation.footprint import Polygon, Rectangle
from mdms_host.layout import Layout

SENSORS_M = Layout(6, 3).sensor_positions_m.reshape(-1, 2)
PENTAGON = Polygon(((0.18, -0.15), (0.18, 0.05), (0.05, 0.15), (-0.18, 0.12), (-0.15, -0.15)))
POSE = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-4, 4)).map(np.array)
POINT = st.tuples(st.floats(-1, 1), st.floats(-1, 1)).map(lambda point: np.array([point]))


def regular(corners: int) -> Polygon:
    turns = np.exp(2j * np.pi * np.arange(corners) / corners) * 0.2
    return Polygon(tuple((float(turn.real), float(turn.imag)) for turn in turns))


@given(POSE, POINT)
def test_four_right_angles_make_a_rectangle(pose: np.ndarray, point_m: np.ndarray) -> None:
    box = Polygon(((0.18, -0.15), (0.18, 0.15), (-0.18, 0.15), (-0.18, -0.15)))
    same = Rectangle(0.36, 0.30)
    np.testing.assert_allclose(
        box.distance_m(point_m, pose), same.distance_m(point_m, pose), atol=1e-12
    )
    assert box.reach_m == same.reach_m
    assert box.period_rad == pytest.approx(same.period_rad)


@given(POSE, POINT)
def test_slope_of_the_edge_agrees_with_differences(pose: np.ndarray, point_m: np.ndarray) -> None:
    distance_m, slope = PENTAGON.edge(point_m[0], pose)
    ways = 1e-6 * np.eye(3)
    # On a crease of the distance the slopes to both sides differ.
    around = [PENTAGON.edge(point_m[0], pose + sign * d)[1] for d in ways for sign in (-1, 1)]
    assume(all(np.allclose(slope, other, atol=1e-4) for other in around))
    differences = [
        (PENTAGON.distance_m(point_m, pose + d) - PENTAGON.distance_m(point_m, pose - d))[0] / 2e-6
        for d in ways
    ]
    np.testing.assert_allclose(slope, differences, atol=1e-5)
    np.testing.assert_allclose(distance_m, PENTAGON.distance_m(point_m, pose)[0], atol=1e-12)


@pytest.mark.parametrize("corners", [3, 4, 5, 6])
def test_a_regular_outline_looks_the_same_after_one_corner(corners: int) -> None:
    assert regular(corners).period_rad == pytest.approx(2 * np.pi / corners)


def test_most_outlines_look_the_same_after_a_whole_turn_only() -> None:
    assert PENTAGON.period_rad == pytest.approx(2 * np.pi)


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.18, 0.18), st.floats(-0.03, 0.03), st.floats(-0.4, 0.4))
def test_a_polygon_is_found_within_the_spread_that_is_stated(
    x: float, y: float, yaw: float
) -> None:
    covered = PENTAGON.distance_m(SENSORS_M, np.array([x, y, yaw])) < 0
    found = locate(PENTAGON, SENSORS_M, covered)
    assert found is not None
    off = found.pose - (x, y, yaw)
    assert off @ np.linalg.solve(found.covariance, off) < 16
    assert np.hypot(*off[:2]) < 0.035


def test_one_wrong_sensor_is_counted() -> None:
    covered = PENTAGON.distance_m(SENSORS_M, np.zeros(3)) < 0
    covered[np.argmin(np.hypot(*SENSORS_M.T))] = False
    found = locate(PENTAGON, SENSORS_M, covered)
    assert found is not None
    assert found.contradictions == 1
