import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.host.estimation.lying import locate

from mdms_host.estimation.footprint import Rectangle
from mdms_host.layout import Layout

SENSORS_M = Layout(6, 3).sensor_positions_m.reshape(-1, 2)
BOTTOM = Rectangle(0.36, 0.30)


def covered_by(footprint: Rectangle, *pose: float) -> np.ndarray:
    return footprint.distance_m(SENSORS_M, np.array(pose)) < 0


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.18, 0.18), st.floats(-0.03, 0.03), st.floats(-0.4, 0.4))
def test_a_parcel_is_found_within_the_spread_that_is_told(x: float, y: float, yaw: float) -> None:
    found = locate(BOTTOM, SENSORS_M, covered_by(BOTTOM, x, y, yaw))
    assert found is not None
    off = found.pose - (x, y, yaw)
    assert off @ np.linalg.solve(found.covariance, off) < 16
    assert np.hypot(*off[:2]) < 0.035


def test_sensors_that_no_pose_explains_are_counted() -> None:
    covered = covered_by(BOTTOM, 0.0, 0.0, 0.0)
    covered[np.argmin(np.hypot(*SENSORS_M.T))] = False
    found = locate(BOTTOM, SENSORS_M, covered)
    assert found is not None
    assert found.contradictions == 1
    assert np.hypot(*found.pose[:2]) < 0.035


def test_nothing_is_found_where_nothing_lies() -> None:
    assert locate(BOTTOM, SENSORS_M, np.zeros(len(SENSORS_M), dtype=bool)) is None


def test_nothing_is_found_if_the_parcel_is_too_small_for_the_covered_sensors() -> None:
    covered = covered_by(BOTTOM, 0.0, 0.0, 0.0)
    assert locate(Rectangle(0.1, 0.1), SENSORS_M, covered) is None


def test_the_hint_chooses_between_yaws_that_look_the_same() -> None:
    covered = covered_by(BOTTOM, 0.02, 0.0, 0.2)
    found = locate(BOTTOM, SENSORS_M, covered, yaw_hint_rad=np.pi)
    assert found is not None
    assert abs(found.pose[2] - (np.pi + 0.2)) < 0.2


def test_no_parcel_is_found_with_its_middle_outside_the_table() -> None:
    """Of a parcel beyond the edge only the first column of sensors would be covered."""
    covered = covered_by(BOTTOM, -0.50, 0.0, 0.0)
    assert covered.any()
    beyond = locate(BOTTOM, SENSORS_M, covered)
    assert beyond is not None
    assert beyond.pose[0] < -0.45
    within_m = np.array([(-0.35, -0.16), (0.35, 0.16)])
    inside = locate(BOTTOM, SENSORS_M, covered, within_m=within_m)
    assert inside is not None
    assert abs(inside.pose[0]) < 0.35
    assert inside.contradictions > beyond.contradictions
