import numpy as np
import pytest
from tests.host.estimation.lying import agree, locate

from mdms_host.estimation.belief import Standing
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.locating import Location
from mdms_host.estimation.pose.estimator import ParcelEstimator, Shown
from mdms_host.estimation.pose.rolling import Speeds, roll_on
from mdms_host.estimation.presence import Surroundings
from mdms_host.layout import Layout, WheelPlace

LAYOUT = Layout(6, 3, wheels=(WheelPlace(0.0, (0.0, 0.03)), WheelPlace(np.pi / 2, (0.03, 0.0))))
SENSORS_M = LAYOUT.sensor_positions_m.reshape(-1, 2)
BOTTOM = Rectangle(0.36, 0.30)
SURROUNDINGS = Surroundings(LAYOUT)


def covered_by(pose: np.ndarray) -> np.ndarray:
    return BOTTOM.distance_m(SENSORS_M, pose) < 0


def resting_at(*pose: float) -> ParcelEstimator:
    estimator = ParcelEstimator(SURROUNDINGS, BOTTOM)
    found = locate(BOTTOM, SENSORS_M, covered_by(np.array(pose)))
    assert found is not None
    estimator.start(0.0, found)
    return estimator


def carry(
    estimator: ParcelEstimator, pose: np.ndarray, twist: np.ndarray, seconds: float, scale: float
) -> np.ndarray:
    """Move the true parcel, giving the wheels' speeds scaled, and each edge as it happens."""
    covered, step_s = covered_by(pose), 0.01
    for step in range(1, round(seconds / step_s) + 1):
        pose = pose + twist * step_s
        now_s = step * step_s
        speeds_m_s = LAYOUT.surface_jacobian(*pose[:2]) @ twist * scale
        roll_on([estimator], now_s, Speeds(speeds_m_s))
        for sensor in np.flatnonzero(covered_by(pose) != covered):
            estimator.edge(now_s, SENSORS_M[sensor], not covered[sensor])
        covered = covered_by(pose)
        agree(estimator, now_s, covered)
    return pose


def moving(pose: np.ndarray, twist: np.ndarray, variances: list[float]) -> ParcelEstimator:
    """Of a parcel that is at a pose at 0.01 s, and has been carried by this twist for 0.2 s."""
    estimator = ParcelEstimator(SURROUNDINGS, BOTTOM)
    # The first step begins at rest, and its speeds are 2 ms late.
    estimator.start(-0.19, Location(pose - twist * 0.197, np.diag(variances), 0))
    for step in range(-18, 2):
        roll_on([estimator], 0.01 * step, Speeds(LAYOUT.surface_jacobian(*pose[:2]) @ twist))
    return estimator


def test_wheels_that_roll_tell_the_twist_exactly() -> None:
    estimator, twist = resting_at(0.0, 0.0, 0.0), np.array([0.05, -0.02, 0.3])
    roll_on([estimator], 0.01, Speeds(LAYOUT.surface_jacobian(*estimator.pose[:2]) @ twist))
    np.testing.assert_allclose(estimator.twist, twist, atol=1e-12)


def test_wheels_that_slip_hardly_change_the_twist() -> None:
    estimator, twist = resting_at(0.0, 0.0, 0.0), np.array([0.05, 0.0, 0.0])
    speeds_m_s = LAYOUT.surface_jacobian(*estimator.pose[:2]) @ twist
    under = np.flatnonzero(BOTTOM.distance_m(LAYOUT.wheel_positions_m, estimator.pose) < 0)
    speeds_m_s[under[:4]] += 0.2
    roll_on([estimator], 0.01, Speeds(speeds_m_s))
    np.testing.assert_allclose(estimator.twist, twist, atol=0.004)


def slipping() -> ParcelEstimator:
    """Of a parcel whose wheels have gained 0.1 m/s in 0.2 s, half of which did not push it."""
    estimator = resting_at(0.0, 0.0, 0.0)
    for step in range(1, 21):
        twist = np.array([0.005 * step, 0.0, 0.0])
        roll_on([estimator], 0.01 * step, Speeds(LAYOUT.surface_jacobian(0.0, 0.0) @ twist))
        estimator.slide(np.array([0.25, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]), 0.01)
    return estimator


def unsurer_m2(estimator: ParcelEstimator, now_s: float, speed_m_s: float) -> float:
    """The growth of the variance across the way in a cycle."""
    before_m2 = float(estimator.covariance[1, 1])
    speeds_m_s = LAYOUT.surface_jacobian(0.0, 0.0) @ (speed_m_s, 0.0, 0.0)
    standing = np.full(len(speeds_m_s), speed_m_s == 0.0)
    roll_on([estimator], now_s, Speeds(speeds_m_s, standing=standing))
    return float(estimator.covariance[1, 1]) - before_m2


def test_wheels_that_slip_make_the_place_less_sure() -> None:
    assert unsurer_m2(slipping(), 0.21, 0.1) > 1e-6


def test_wheels_that_stand_or_push_nothing_do_not_slip() -> None:
    assert unsurer_m2(slipping(), 0.21, 0.0) < 1e-7
    estimator = slipping()
    for step in range(21, 32):
        last_m2 = unsurer_m2(estimator, 0.01 * step, 0.1)
    assert last_m2 < 1e-7


def test_a_time_without_speeds_is_told_and_ends_the_slip() -> None:
    estimator = slipping()
    roll_on([estimator], 0.35, Speeds(LAYOUT.surface_jacobian(0.0, 0.0) @ (0.01, 0.0, 0.0)))
    assert estimator.unseen
    assert unsurer_m2(estimator, 0.36, 0.01) < 1e-6
    assert not estimator.unseen


def test_a_report_that_got_lost_does_not_push_a_fast_parcel_aside() -> None:
    """An edge has just reached the sensors ahead: that tells of it, and is no contradiction."""
    ahead_m = np.unique(SENSORS_M[:, 0])[-6]
    pose = np.array([ahead_m - BOTTOM.length_m / 2 - 0.001, 0.0, 0.0])
    twist = np.array([0.45, 0.0, 0.0])
    estimator = moving(pose, twist, [1e-6, 5e-4, 1e-4])
    view = estimator.view(0.01)
    assert view is not None
    x_m, y_m = view.near.sensors_m.T
    under, across = view.distance_m < 0, abs(y_m) < BOTTOM.width_m / 2
    reached = across & (abs(x_m - ahead_m) < 0.01)
    missed = under & (x_m > ahead_m - 0.07) & (y_m > 0.0)
    left = across & ~under & (x_m < pose[0]) & (x_m > pose[0] - BOTTOM.length_m / 2 - 0.06)
    assert (reached.sum(), missed.sum(), left.sum()) == (4, 2, 4)
    silent_s = np.where(missed, 0.14, -0.005)
    same_s = np.where(reached | left, 0.05, 1.0)
    mine, covered = np.ones(len(under), dtype=bool), (under | reached) & ~missed
    estimator.agree(
        0.01, view, Shown(view.near.sensors // 5, covered, mine, silent_s, same_s, ~mine)
    )
    assert abs(estimator.pose[1]) < 0.001


def last_silent(*, old: bool) -> float:
    """How far a sensor pushes a box back that it should have reached 4 mm ago [m].

    Its cell has told nothing for 50 ms, and none of the others has anything to tell. A report is
    `old` where one has got lost, or may have.
    """
    twist = np.array([0.1, 0.0, 0.0])
    ahead_m = np.unique(SENSORS_M[:, 0])[-6]
    pose = np.array([ahead_m - BOTTOM.length_m / 2 + 0.004, 0.0, 0.0])
    estimator = moving(pose, twist, [1e-6, 1e-6, 1e-6])
    before = estimator.pose.copy()
    view = estimator.view(0.01)
    assert view is not None
    covered = view.distance_m < 0
    near = view.near.sensors_m
    ahead = np.flatnonzero(covered & (abs(near[:, 0] - ahead_m) < 0.002))
    covered[ahead[0]] = False
    mine, silent_s = np.ones(len(covered), dtype=bool), np.full(len(covered), 0.05)
    same_s, unheard = np.full(len(covered), 1.0), np.full(len(covered), old)
    estimator.agree(
        0.01, view, Shown(view.near.sensors // 5, covered, mine, silent_s, same_s, unheard)
    )
    return float(np.linalg.norm(estimator.pose - before))


def test_a_silent_sensor_contradicts_only_where_no_report_may_have_got_lost() -> None:
    """One lost report pushed a box 8 mm aside that arrived there, with 2 % of all frames lost."""
    assert last_silent(old=True) == 0.0
    assert last_silent(old=False) > 0.001


def test_a_sensor_that_is_just_passed_is_no_second_report_that_has_got_lost() -> None:
    """Others have told of theirs, and one has not for 0.1 s. The next is due now."""
    ahead_m = np.unique(SENSORS_M[:, 0].round(6))[-5]
    pose = np.array([ahead_m - BOTTOM.length_m / 2 + 0.0003, 0.0, 0.0])
    twist = np.array([0.3, 0.0, 0.0])
    estimator = moving(pose, twist, [1e-5, 1e-5, 4e-4])
    pose = estimator.pose.copy()
    view = estimator.view(0.01)
    assert view is not None
    x_m, y_m = view.near.sensors_m.T
    under, behind = view.distance_m < 0, x_m < pose[0]
    reached = np.flatnonzero(under & (abs(x_m - ahead_m) < 1e-6))
    left = np.flatnonzero(~under & behind & (abs(y_m) < 0.14) & (view.distance_m < 0.025))
    assert (len(reached), len(left)) == (3, 3)
    covered, same_s = under.copy(), np.full(len(under), 1.0)
    covered[reached[0]], covered[left[0]] = False, True
    same_s[[*reached[1:], *left[1:]]] = 0.1
    mine, silent_s = np.ones(len(under), dtype=bool), np.full(len(under), 0.05)
    silent_s[left[0]] = 0.1
    estimator.agree(
        0.01, view, Shown(view.near.sensors // 5, covered, mine, silent_s, same_s, ~mine)
    )
    assert np.abs(estimator.pose - pose).max() < 1e-6


def test_a_cell_that_alone_shows_what_cannot_be_believed_moves_no_estimate() -> None:
    """All its sensors were stuck at 'free': a box on its way over them was believed 42 mm aside."""
    pose, twist = np.array([0.055, 0.0, 0.0]), np.array([0.3, 0.0, 0.0])
    estimator = moving(pose, twist, [1e-6, 6e-5, 1e-5])
    before = estimator.pose.copy()
    view = estimator.view(0.01)
    assert view is not None
    cells = view.near.sensors // 5
    covered = (view.distance_m < 0) & (cells != 10)
    mine, silent_s = np.ones(len(cells), dtype=bool), np.zeros(len(cells))
    shown = Shown(cells, covered, mine, silent_s, silent_s + 1.0, ~mine)
    assert estimator.agree(0.01, view, shown) is Standing.FOUND
    assert (estimator.pose == before).all()


def test_wheels_beside_the_parcel_tell_nothing() -> None:
    estimator = resting_at(0.0, 0.0, 0.0)
    beside = BOTTOM.distance_m(LAYOUT.wheel_positions_m, estimator.pose) > 0
    roll_on([estimator], 0.01, Speeds(np.where(beside, 0.3, 0.0)))
    np.testing.assert_array_equal(estimator.twist, np.zeros(3))


def test_a_row_of_wheels_leaves_the_motion_that_it_cannot_show() -> None:
    row = Layout(10, 1, wheels=(WheelPlace(0.0),))
    footprint = Rectangle(0.4445, 0.10)
    estimator = ParcelEstimator(Surroundings(row), footprint)
    estimator.start(0.0, Location(np.array([-0.2, 0.0, 0.0]), np.diag([1e-4, 1e-4, 1e-4]), 0))
    roll_on([estimator], 0.01, Speeds(np.full(10, 0.04)))
    np.testing.assert_allclose(estimator.twist, [0.04, 0.0, 0.0], atol=1e-12)


def test_an_edge_that_is_told_of_late_throws_no_fast_parcel_about() -> None:
    """Its report got lost, and came with that of another sensor 25 ms later."""
    x_m, twist = np.unique(SENSORS_M[:, 0])[-6], np.array([0.45, 0.0, 0.0])
    pose = np.array([x_m - BOTTOM.length_m / 2 + 0.011, 0.0, 0.0])
    estimator = moving(pose, twist, [1e-6, 3e-5, 5e-5])
    pose, covariance = estimator.pose.copy(), estimator.covariance.copy()
    estimator.edge(0.01, np.array([x_m, 0.095]), covered=True)
    np.testing.assert_array_equal(estimator.pose, pose)
    np.testing.assert_array_equal(estimator.covariance, covariance)
    # One that has not been passed is told of in time.
    estimator.edge(0.01, np.array([x_m + 0.02, 0.095]), covered=True)
    assert abs(estimator.pose[0] - pose[0]) > 0.005


@pytest.mark.parametrize(("passed_m", "late"), [(0.025, True), (0.006, False)])
def test_an_edge_is_late_that_others_have_told_of_however_unsure_the_place_is(
    passed_m: float, late: bool
) -> None:
    """A box that slips got the edge 28 mm behind it as news, and was lost half a second later.

    One that is some millimetres behind it is news.
    """
    behind_m = np.unique(SENSORS_M[:, 0].round(6))[5]
    pose = np.array([behind_m + BOTTOM.length_m / 2 + passed_m, 0.0, 0.0])
    twist = np.array([0.55, 0.0, 0.0])
    estimator = moving(pose, twist, [3.6e-5, 3e-4, 7e-4])
    view = estimator.view(0.01)
    assert view is not None
    x_m, y_m = view.near.sensors_m.T
    covered, same_s = view.distance_m < 0, np.full(len(x_m), 1.0)
    passed = np.flatnonzero((abs(x_m - behind_m) < 1e-6) & (abs(y_m) < 0.14))
    others = np.flatnonzero(~covered & (abs(y_m) < 0.14) & (x_m < pose[0]))
    covered[passed[0]], same_s[others] = True, 0.1
    same_s[passed[0]] = 1.0
    mine, silent_s = np.ones(len(x_m), dtype=bool), np.full(len(x_m), 0.1)
    estimator.agree(
        0.01, view, Shown(view.near.sensors // 5, covered, mine, silent_s, same_s, ~mine)
    )
    pose = estimator.pose.copy()
    estimator.edge(0.015, view.near.sensors_m[passed[0]], covered=False)
    assert np.array_equal(estimator.pose, pose) == late
    # Where it has been found anew, no edge has been told of yet.
    estimator.start(0.02, Location(pose, np.diag([3.6e-5, 3e-4, 7e-4]), 0))
    roll_on([estimator], 0.03, Speeds(LAYOUT.surface_jacobian(*pose[:2]) @ twist))
    pose = estimator.pose.copy()
    estimator.edge(0.035, view.near.sensors_m[passed[0]], covered=False)
    assert not np.array_equal(estimator.pose, pose)


def test_a_lost_report_of_a_sensor_at_a_corner_pushes_no_parcel_that_gains_speed() -> None:
    """By its speed of now, the box had not yet covered the sensor 0.12 s ago. It had, just so."""
    sensor = np.hypot(*(SENSORS_M - (-0.1, -0.1)).T).argmin()
    x_m, y_m = SENSORS_M[sensor]
    pose = np.array([x_m + 0.18 + 0.015, y_m + 0.15 - 0.0115, 0.0])
    gain = np.array([0.93, -0.6, 0.0])
    estimator = ParcelEstimator(SURROUNDINGS, BOTTOM)
    estimator.start(0.0, Location(pose - gain * 0.25**2 / 2, np.diag([3e-5, 1e-4, 7e-4]), 0))
    for step in range(1, 26):
        twist = gain * 0.01 * step
        roll_on([estimator], 0.01 * step, Speeds(LAYOUT.surface_jacobian(*pose[:2]) @ twist))
    before, view = estimator.pose.copy(), estimator.view(0.25)
    assert view is not None
    covered, same_s = view.distance_m < 0, np.full(len(view.distance_m), 1.0)
    silent = np.flatnonzero(view.near.sensors == sensor)
    assert not covered[silent]
    covered[silent], same_s[np.flatnonzero(covered)[:6]] = True, 0.1
    same_s[silent] = 1.0
    mine, silent_s = np.ones(len(covered), dtype=bool), np.full(len(covered), 0.119)
    estimator.agree(
        0.25, view, Shown(view.near.sensors // 5, covered, mine, silent_s, same_s, ~mine)
    )
    np.testing.assert_array_equal(estimator.pose, before)


def test_a_motion_goes_on_while_reports_of_the_wheels_that_show_it_are_missing() -> None:
    estimator, twist = resting_at(0.0, 0.0, 0.0), np.array([0.4, 0.0, 0.0])
    speeds_m_s = LAYOUT.surface_jacobian(0.0, 0.0) @ twist
    roll_on([estimator], 0.01, Speeds(speeds_m_s))
    across = abs(LAYOUT.surface_jacobian(0.0, 0.0)[:, 1]) > 0.5
    for step in range(2, 11):
        roll_on([estimator], 0.01 * step, Speeds(speeds_m_s, known=across))
        np.testing.assert_allclose(estimator.twist, twist, atol=1e-9)
    roll_on([estimator], 0.12, Speeds(speeds_m_s, known=across))
    np.testing.assert_allclose(estimator.twist, np.zeros(3), atol=1e-9)


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.1])
def test_edges_keep_the_error_small_though_wheels_tell_wrong_speeds(scale: float) -> None:
    start = np.array([-0.12, 0.01, 0.05])
    estimator = resting_at(*start)
    pose = carry(estimator, start, np.array([0.1, -0.005, 0.2]), 2.5, scale)
    error = estimator.pose - pose
    assert np.hypot(*error[:2]) < 0.005
    assert abs(error[2]) < np.radians(1.5)


def test_an_edge_makes_the_estimate_surer_across_it_only() -> None:
    estimator = resting_at(0.0, 0.0, 0.0)
    estimator.start(0.0, Location(np.zeros(3), np.diag([1e-4, 1e-4, 1e-6]), 0))
    sensor = int(np.argmin(np.hypot(*(SENSORS_M - (0.1905, 0.0)).T)))
    estimator.edge(0.0, SENSORS_M[sensor], covered=True)
    assert estimator.pose[0] == pytest.approx(0.0105, rel=0.05)
    assert estimator.covariance[0, 0] < 5e-6
    assert estimator.covariance[1, 1] == pytest.approx(1e-4)


@pytest.mark.parametrize("covered", [True, False])
def test_an_edge_corrects_only_where_the_parcel_moves_over_the_sensor_that_way(
    covered: bool,
) -> None:
    estimator = resting_at(0.0, 0.0, 0.0)
    forward = np.array([0.05, 0.0, 0.0])
    roll_on([estimator], 0.01, Speeds(LAYOUT.surface_jacobian(0.0, 0.0) @ forward))
    before_m = estimator.pose[0]
    ahead = int(np.argmin(np.hypot(*(SENSORS_M - (0.1905, 0.0)).T)))
    estimator.edge(0.01, SENSORS_M[ahead], covered)
    assert (estimator.pose[0] > before_m + 0.001) == covered


def test_a_parcel_that_was_pushed_away_is_doubtful() -> None:
    estimator = resting_at(-0.1, 0.0, 0.0)
    pushed = np.array([0.05, 0.0, 0.1])
    for step in range(20):
        now_s = step * 0.01
        roll_on([estimator], now_s, Speeds(np.zeros(36)))
        agree(estimator, now_s, covered_by(pushed))
    assert estimator.standing is Standing.DOUBTFUL


def test_one_stuck_sensor_does_not_pull_the_estimate_away() -> None:
    start = np.array([0.0, 0.0, 0.0])
    estimator = resting_at(*start)
    stuck = covered_by(start)
    stuck[int(np.argmin(np.hypot(*SENSORS_M.T)))] = False
    before = estimator.pose
    for step in range(50):
        now_s = step * 0.01
        roll_on([estimator], now_s, Speeds(np.zeros(36)))
        agree(estimator, now_s, stuck)
    np.testing.assert_allclose(estimator.pose, before, atol=1e-3)


@pytest.mark.parametrize("left", [0.0, 0.1])
def test_a_parcel_that_hardly_moves_after_a_silence_has_gone_on_at_its_beginning(left) -> None:
    # At 0.1 m/s for 0.1 s, however long nothing is heard of it then: 10 mm, give or take 5.
    for silence_s in (0.2, 0.6):
        estimator, twist = resting_at(0.0, 0.0, 0.0), np.array([0.1, 0.0, 0.0])
        jacobian = LAYOUT.surface_jacobian(*estimator.pose[:2])
        roll_on([estimator], 0.01, Speeds(jacobian @ twist))
        x_m, aside_m2 = estimator.pose[0], estimator.covariance[1, 1]
        speeds_m_s = jacobian @ (left * twist)
        known = np.full(len(speeds_m_s), left > 0.0)
        roll_on([estimator], 0.01 + silence_s, Speeds(speeds_m_s, known))
        unsure_m = 0.005 * (1.0 - left)
        assert estimator.pose[0] - x_m == pytest.approx(
            0.1 * left * silence_s + 2 * unsure_m, abs=1e-4
        )
        assert estimator.covariance[0, 0] >= unsure_m**2
        # It is braked on its way: aside it has hardly moved.
        assert estimator.covariance[1, 1] - aside_m2 < (unsure_m / 2) ** 2


def test_a_parcel_that_still_moves_after_a_silence_has_moved_all_the_time() -> None:
    estimator, twist = resting_at(0.0, 0.0, 0.0), np.array([0.1, 0.0, 0.0])
    for now_s in (0.01, 0.31):
        x_m = estimator.pose[0]
        roll_on([estimator], now_s, Speeds(LAYOUT.surface_jacobian(*estimator.pose[:2]) @ twist))
    assert estimator.pose[0] - x_m == pytest.approx(0.03, abs=1e-4)
