from math import sqrt

import numpy as np
import pytest
import toppra
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.host.motion.driving import BOX, LAYOUT, mass_of, straight, traction_of
from toppra.algorithm import TOPPRA
from toppra.constraint import SecondOrderConstraint

from mdms_host.motion.trajectory.path import Path
from mdms_host.motion.trajectory.pushes import Mass, pushes_at
from mdms_host.motion.trajectory.speed_profile import SpeedProfile
from mdms_host.motion.trajectory.traction import PLANNED_SHARE

REACH_M = BOX.footprint.reach_m
WEIGHT_N = 2.0 * 9.81
POSE = st.tuples(st.floats(-0.15, 0.15), st.floats(-0.03, 0.03), st.floats(-3, 3))
PATHS = st.lists(POSE, min_size=2, max_size=4).map(lambda poses: Path(np.array(poses), REACH_M))
MASSES = st.sampled_from([mass_of(BOX), Mass(2.0, 0.05, (0.04, -0.03))])


def profile_of(path: Path, mass: Mass, friction: float = 0.3, speed_m_s: float = 2.0):
    return traction_of(speed_m_s=speed_m_s, friction=friction).profile(path, BOX.footprint, mass)


def rates(profile: SpeedProfile) -> tuple[np.ndarray, np.ndarray]:
    """Speeds at the samples, and accelerations between them."""
    speeds_m_s = profile.speeds_m_s
    return speeds_m_s, np.diff(speeds_m_s**2) / 2 / np.diff(profile.s_m)


@settings(max_examples=10, deadline=None)
@given(PATHS, MASSES)
def test_no_wheel_is_ever_asked_for_more_than_friction_gives(path: Path, mass: Mass) -> None:
    profile = profile_of(path, mass)
    speeds_m_s, between_m_s2 = rates(profile)
    for number, rate_m_s2 in enumerate(between_m_s2):
        piece = path.piece_at((profile.s_m[number] + profile.s_m[number + 1]) / 2)
        for end in (number, number + 1):
            pose = piece.pose_at(profile.s_m[end])
            pushes = pushes_at(LAYOUT, BOX.footprint, mass, pose[None, :], WEIGHT_N)
            turning = (piece.direction[2] * speeds_m_s[end]) ** 2
            wrench = pushes.wrench(piece.direction * rate_m_s2) + pushes.turning_wrench() * turning
            assert abs(pushes.shares(wrench)).max() <= PLANNED_SHARE * 0.3 * (1 + 1e-6)


@settings(max_examples=25, deadline=None)
@given(PATHS, MASSES)
def test_a_parcel_rests_at_both_ends_and_at_corners_and_keeps_to_the_cap(path, mass) -> None:
    profile = profile_of(path, mass, speed_m_s=0.2)
    speeds_m_s, _ = rates(profile)
    assert speeds_m_s.max() <= 0.2 + 1e-9
    rests_m_s = np.interp((0.0, *path.corners_m), profile.s_m, speeds_m_s)
    assert rests_m_s == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(PATHS, MASSES, st.floats(0.05, 0.5), st.floats(1.01, 2.0))
def test_more_friction_never_takes_longer(path, mass, friction, more) -> None:
    slow = profile_of(path, mass, friction)
    fast = profile_of(path, mass, friction * more)
    assert fast.duration_s <= slow.duration_s + 1e-9


def test_a_quarter_metre_takes_the_time_that_friction_allows() -> None:
    path = straight(np.array([-0.125, 0.0, 0.0]), np.array([0.125, 0.0, 0.0]), REACH_M)
    duration_s = profile_of(path, mass_of(BOX)).duration_s
    # Half of the wheels push along x; they carry about half of the box.
    assert duration_s == pytest.approx(2 * sqrt(0.25 / (PLANNED_SHARE * 0.3 * 9.81 / 2)), rel=0.05)


def test_little_voltage_makes_it_slower_than_friction_does() -> None:
    path = straight(np.array([-0.125, 0.0, 0.0]), np.array([0.125, 0.0, 0.0]), REACH_M)
    usual = traction_of(speed_m_s=2.0)
    drives = usual.drives
    weak = type(drives)(
        drives.a_n_s_per_m, drives.b_n_s_per_m, 0.0, drives.stall_n / 20, drives.slope_n_s_per_m
    )
    slow = type(usual)(LAYOUT, weak, speed_m_s=2.0).profile(path, BOX.footprint, mass_of(BOX))
    speeds_m_s, between_m_s2 = rates(slow)
    assert slow.duration_s > 1.3 * usual.profile(path, BOX.footprint, mass_of(BOX)).duration_s
    pushes = pushes_at(LAYOUT, BOX.footprint, mass_of(BOX), path.start[None, :], WEIGHT_N)
    normal_n = pushes.normal_n[0]
    for speed_m_s, rate_m_s2 in zip(speeds_m_s[1:], between_m_s2, strict=True):
        needed = pushes.shares(pushes.wrench(np.array([rate_m_s2, 0, 0])))[0] * normal_n
        assert needed.max() + weak.slope_n_s_per_m * speed_m_s <= weak.stall_n * 1.3


def test_wheels_of_lost_cells_push_nothing_and_drag() -> None:
    path = straight(np.array([-0.15, 0.0, 0.0]), np.array([0.15, 0.0, 0.2]), REACH_M)
    traction = traction_of(speed_m_s=2.0)
    whole = traction.profile(path, BOX.footprint, mass_of(BOX))
    traction.lose({8, 9})
    profile = traction.profile(path, BOX.footprint, mass_of(BOX))
    assert profile.duration_s > 1.15 * whole.duration_s
    lost = np.isin(LAYOUT.wheel_cells, [8, 9])
    for _, pushes in profile.pushes:
        assert not pushes.pushing_n[:, lost[pushes.wheels]].any()
        np.testing.assert_allclose(pushes.normal_n.sum(axis=1), WEIGHT_N)


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ((-0.15, 0.0, 0.0), (0.15, 0.0, 0.0)),
        ((-0.15, 0.02, 0.3), (0.12, -0.02, 0.8)),
        ((0.0, 0.0, 0.0), (0.02, 0.01, 1.5)),
    ],
)
def test_it_is_as_fast_as_an_independent_planner_finds(start, end) -> None:
    path = straight(np.array(start), np.array(end), REACH_M)
    profile = profile_of(path, mass_of(BOX), speed_m_s=5.0)
    assert profile.duration_s == pytest.approx(_planned_by_toppra_s(path, profile), rel=0.02)


def _planned_by_toppra_s(path: Path, profile: SpeedProfile) -> float:
    """TOPP-RA's time with the wheels' shares of friction as its only constraint."""
    wheels = len(LAYOUT.wheel_positions_m)

    def shares(pose: np.ndarray, _: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        pushes = pushes_at(LAYOUT, BOX.footprint, mass_of(BOX), pose[None, :], WEIGHT_N)
        every = np.zeros(wheels)
        every[pushes.wheels] = pushes.shares(pushes.wrench(acceleration))[0]
        return every

    within = np.vstack((np.eye(wheels), -np.eye(wheels)))
    limit = np.full(2 * wheels, PLANNED_SHARE * 0.3)
    constraint = SecondOrderConstraint(
        shares, lambda _: within, lambda _: limit, 3, lambda *_: np.zeros(wheels)
    )
    way = toppra.SplineInterpolator([0.0, path.length_m], np.array([path.start, path.end]))
    instance = TOPPRA([constraint], way, gridpoints=profile.s_m)
    _, speeds_m_s, _ = instance.compute_parameterization(0.0, 0.0, return_data=True)[:3]
    return float((2 * np.diff(profile.s_m) / (speeds_m_s[:-1] + speeds_m_s[1:])).sum())


def test_planners_count_on_no_more_acceleration_than_a_profile_has() -> None:
    traction = traction_of(speed_m_s=0.5)
    agility = traction.agility(BOX.footprint, mass_of(BOX))
    poses = [(-0.15, 0.0, 0.0), (0.1, 0.02, 0.0), (0.1, -0.02, 0.0), (0.1, -0.02, 1.0)]
    path = Path(np.array(poses), REACH_M)
    profile = traction.profile(path, BOX.footprint, mass_of(BOX))
    for piece in path.pieces:
        planned_m_s2 = agility.acceleration_m_s2(piece.direction)
        within = (profile.s_m[:-1] >= piece.start_s_m) & (profile.s_m[1:] <= piece.end_s_m)
        least_m_s2 = profile.acceleration_m_s2[within].min()
        assert 0.6 * least_m_s2 <= planned_m_s2 <= 1.02 * least_m_s2
