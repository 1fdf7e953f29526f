import numpy as np
import pytest

from mdms_host.estimation.pose.pose_filter import Sliding

CORNER_M = np.array([1.0, 1.0, 5.0])
STEP_S = 0.01
AHEAD = np.array([1.0, 0.0, 0.0])


def gaining(sliding: Sliding, missing_m_s2: float, gained_m_s2: float, seconds: float) -> None:
    for _ in range(round(seconds / STEP_S)):
        sliding.step(missing_m_s2 * AHEAD, gained_m_s2 * AHEAD, STEP_S)


@pytest.mark.parametrize("missing_m_s2", [-0.12, 0.0, 0.12])
def test_motors_that_differ_are_no_slip(missing_m_s2: float) -> None:
    sliding = Sliding(CORNER_M)
    gaining(sliding, missing_m_s2, 1.0, 1.0)
    assert not sliding.twist.any()
    assert sliding.variance_m2_s == 0.0


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_wheels_that_gain_more_than_they_push_to_are_so_much_faster(way: float) -> None:
    sliding = Sliding(CORNER_M)
    gaining(sliding, way * 0.5, way * 1.0, 0.2)
    assert sliding.twist[0] == pytest.approx(way * 0.1)
    assert sliding.variance_m2_s > 0.0


def test_wheels_that_the_parcel_catches_up_with_roll() -> None:
    sliding = Sliding(CORNER_M)
    gaining(sliding, 0.5, 1.0, 0.2)
    gaining(sliding, -0.5, -0.2, 0.21)
    assert not sliding.twist.any()


def test_wheels_that_push_less_than_they_slipped_with_roll() -> None:
    sliding = Sliding(CORNER_M)
    gaining(sliding, 0.5, 1.0, 0.2)
    gaining(sliding, 0.0, 0.4, 0.1)
    assert sliding.twist.any()
    gaining(sliding, 0.0, 0.1, 0.1)
    assert not sliding.twist.any()


def test_slip_that_nothing_confirms_is_over() -> None:
    sliding = Sliding(CORNER_M)
    gaining(sliding, 0.5, 1.0, 0.2)
    gaining(sliding, 0.0, 0.0, 1.0)
    assert not sliding.twist.any()
