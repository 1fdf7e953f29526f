import numpy as np
import pytest

from mdms_host.estimation.pose.pose_filter import PoseFilter

ACROSS = np.array([1.0, 0.0, 0.0, 0.0, 0.0])


def believing(sigma_m: float) -> PoseFilter:
    return PoseFilter(np.zeros(3), np.eye(3) * sigma_m**2, 0.2, np.zeros(2))


def test_an_edge_takes_its_distance_over_and_is_sure_of_it() -> None:
    one = believing(0.01)
    assert one.on_edge(-0.005, ACROSS, 0.0002)
    assert one.mean[0] == pytest.approx(0.005, rel=1e-3)
    assert one.covariance[0, 0] ** 0.5 == pytest.approx(0.0002, rel=1e-2)
    assert one.covariance[1, 1] == 0.01**2


def test_a_surprise_makes_it_as_unsure_as_it_should_have_been() -> None:
    one = believing(0.0002)
    assert one.on_edge(0.005, ACROSS, 0.0002)
    assert one.covariance[1, 1] ** 0.5 > 0.002


def test_a_surprise_makes_the_size_no_less_sure_than_it_was_told() -> None:
    """Where wheels slip unseen every edge is one, and none shows a growth of centimetres."""
    one = PoseFilter(np.zeros(3), np.eye(3) * 1e-6, 0.2, np.zeros(2), 0.001)
    for way in range(20):
        slope = np.array([1.0 if way % 2 else -1.0, 0.0, 0.0, -1.0, 0.0])
        one.on_edge(0.006, slope, 0.0002)
        assert one.covariance[3, 3] ** 0.5 <= 0.001 + 1e-12
    assert np.linalg.eigvalsh(one.covariance).min() > -1e-15


def test_a_surprise_takes_from_no_variance_more_than_there_is() -> None:
    """Where place and growth went together, the place alone is less sure than both were."""
    one = PoseFilter(np.zeros(3), np.eye(3) * 1e-6, 0.2, np.zeros(2), 0.0005)
    one.covariance[3, 3] = 1e-6
    one.covariance[0, 3] = one.covariance[3, 0] = 0.9e-6
    assert one.on_edge(0.004, np.array([1.0, 0.0, 0.0, -1.0, 0.0]), 0.0002)
    assert np.linalg.eigvalsh(one.covariance).min() > -1e-15


def test_surprises_without_end_leave_other_directions_finite() -> None:
    """No edge shows how a disc is turned, nor where it is along the edge."""
    one = believing(0.001)
    for way in range(500):
        one.on_edge(0.011 if way % 2 else -0.011, ACROSS, 0.0002)
    assert np.isfinite(one.covariance).all()
    assert one.covariance[1, 1] ** 0.5 <= 1.0 + 1e-9
    assert one.covariance[2, 2] ** 0.5 <= np.pi + 1e-9


def test_wheels_that_slip_make_a_place_less_sure() -> None:
    rolled, slipped = believing(0.001), believing(0.001)
    for _ in range(10):
        rolled.move(np.array([0.002, 0.0, 0.0]), 0.01)
        slipped.move(np.array([0.002, 0.0, 0.0]), 0.01, 1e-4)
    assert slipped.covariance[1, 1] == pytest.approx(rolled.covariance[1, 1] + 1e-5)
    assert slipped.covariance[3, 3] == rolled.covariance[3, 3]


def test_an_edge_too_far_away_is_not_believed() -> None:
    one = believing(0.001)
    assert not one.on_edge(0.05, ACROSS, 0.0002)
    assert not one.mean.any()


def test_a_bound_that_is_met_again_and_again_counts_once() -> None:
    """As where the belief runs ahead of the truth: its edge is past the sensor already."""
    one = believing(0.01)
    for _ in range(200):
        one.move(np.array([0.0005, 0.0, 0.0]), 0.005)
        if one.mean[0] > 0.0:
            assert one.on_bound(one.mean[0], ACROSS, 0.0002)
        assert one.mean[0] < 0.002
    assert one.covariance[0, 0] ** 0.5 > 0.0015


def test_a_bound_leaves_the_right_side_of_a_normal_distribution() -> None:
    one, chance = believing(0.01), np.random.default_rng(1)
    draws = chance.normal(0.004, 0.01, 200_000)
    one.mean[0] = 0.004
    assert one.on_bound(0.004, ACROSS, 0.0)
    assert one.mean[0] == pytest.approx(draws[draws < 0].mean(), rel=0.02)
    assert one.covariance[0, 0] ** 0.5 == pytest.approx(draws[draws < 0].std(), rel=0.02)


def test_edges_on_both_sides_show_how_large_a_parcel_is() -> None:
    """Each edge turns out to be 2 mm farther out than drawn."""
    one = believing(0.01)
    for _ in range(3):
        for side in (1.0, -1.0):
            slope = np.array([-side, 0.0, 0.0, -1.0, 0.0])
            off_m = 0.002 - side * one.mean[0] - one.mean[3]
            assert one.on_edge(off_m, slope, 0.0002)
    assert one.mean[0] == pytest.approx(0.0, abs=3e-4)
    assert one.mean[3] == pytest.approx(0.002, abs=3e-4)
