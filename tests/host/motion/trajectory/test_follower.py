"""Parcels on wheels of the paper's model follow their paths within their movement authorities."""

from dataclasses import replace
from functools import partial
from random import Random

import numpy as np
import pytest
from tests.host.motion.driving import BOX, STEP_S, Table, mass_of, straight, traction_of

from mdms_host.estimation.pose.pose_filter import Sliding
from mdms_host.motion.trajectory.follower import Follower, Grip
from mdms_host.motion.trajectory.path import Path

REACH_M = BOX.footprint.reach_m
STRAIGHT = straight(np.array([-0.15, 0.0, 0.0]), np.array([0.15, 0.0, 0.3]), REACH_M)
CORNERED = Path(
    np.array([(-0.15, -0.03, 0.0), (0.1, -0.03, 0.2), (0.1, 0.03, 0.2), (0.0, 0.03, -0.5)]), REACH_M
)


def follower_of(path: Path, grip: Grip | None = None, mass_kg: float = 2.0) -> Follower:
    traction = traction_of(speed_m_s=0.7)
    return Follower(traction, traction.profile(path, BOX.footprint, mass_of(BOX, mass_kg)), grip)


def stop_m(follower: Follower) -> float:
    """Before this path coordinate the parcel cannot stop any more."""
    least_m_s2 = follower.profile.acceleration_m_s2.min()
    stop_m = follower.reference.s_m + follower.reference.speed_m_s**2 / 2 / least_m_s2
    return min(stop_m, follower.profile.stop_after(follower.reference.s_m))


def at_m(path: Path, table: Table) -> float:
    """How far along its path a parcel is."""
    return path.nearest_m(table.pose, 0.0, path.length_m)


@pytest.mark.parametrize("path", [STRAIGHT, CORNERED])
@pytest.mark.parametrize("friction", [0.25, 0.6])
def test_a_parcel_keeps_to_its_path_and_its_time(path: Path, friction: float) -> None:
    follower, table = follower_of(path), Table(path.start, friction=friction)
    worst_m = time_s = 0.0
    while not follower.reference.finished:
        table.step(follower.step)
        worst_m = max(worst_m, path.distance_m(path.off(table.pose, at_m(path, table))))
        time_s += STEP_S
        assert time_s < 2 * follower.profile.duration_s
    for _ in range(20):
        table.step(follower.step)
    assert worst_m < 0.004
    assert time_s < 1.05 * follower.profile.duration_s + 0.05
    np.testing.assert_allclose(table.pose, path.end, atol=0.002)
    assert table.slipping <= 0.02 * table.carrying
    assert follower.grip.slips == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_parcel_never_passes_its_authority_however_that_is_extended(seed: int) -> None:
    random = Random(seed)
    friction = random.uniform(0.25, 0.35)
    follower, table = follower_of(CORNERED), Table(CORNERED.start, friction=friction)
    authority_m = 0.0
    for _ in range(700):
        if random.random() < 0.04:
            authority_m = min(authority_m + random.uniform(0.0, 0.15), CORNERED.length_m)
        elif random.random() < 0.02:
            # An authority before which the parcel cannot stop any more is not taken back.
            authority_m = max(stop_m(follower), authority_m - random.uniform(0.0, 0.1))
        table.step(partial(follower.step, authority_s_m=authority_m))
        assert follower.reference.s_m <= authority_m + 1e-4
        assert at_m(CORNERED, table) <= authority_m + 0.003
    assert table.slipping <= 0.02 * table.carrying


def test_without_any_authority_a_parcel_stands() -> None:
    follower, table = follower_of(STRAIGHT), Table(STRAIGHT.start)
    for _ in range(50):
        table.step(partial(follower.step, authority_s_m=0.0))
    np.testing.assert_allclose(table.pose, STRAIGHT.start, atol=1e-4)
    assert follower.reference.at_rest
    assert not follower.reference.finished


def test_an_authority_that_is_withdrawn_too_late_is_overrun_braking() -> None:
    follower, table = follower_of(STRAIGHT), Table(STRAIGHT.start)
    for _ in range(40):
        table.step(follower.step)
    withdrawn_m, committed_m = follower.reference.s_m + 0.001, stop_m(follower)
    for _ in range(80):
        table.step(partial(follower.step, authority_s_m=withdrawn_m))
    assert follower.reference.at_rest
    assert withdrawn_m < follower.reference.s_m <= committed_m + 0.002
    assert abs(table.twist).max() < 0.005


def test_a_parcel_that_is_held_for_a_while_goes_on_from_where_it_is() -> None:
    follower, table = follower_of(STRAIGHT), Table(STRAIGHT.start)
    for _ in range(30):
        table.step(follower.step)
    ahead_m = follower.reference.s_m
    held = Table(STRAIGHT.pose_at(ahead_m - 0.05))
    for _ in range(300):
        held.step(follower.step)
    assert not follower.off_path
    np.testing.assert_allclose(held.pose, STRAIGHT.end, atol=0.002)


def test_a_parcel_that_cannot_move_is_not_run_ahead_of() -> None:
    follower, table = follower_of(STRAIGHT), Table(STRAIGHT.start)
    for _ in range(80):
        blocked = Table(STRAIGHT.start)
        blocked.step(follower.step)
        assert follower.reference.s_m < 0.02
        assert follower.reference.speed_m_s < 0.2
    assert table.pose[0] == STRAIGHT.start[0]


def test_a_parcel_beside_its_path_is_brought_to_rest_and_reported() -> None:
    follower, table = follower_of(STRAIGHT), Table(STRAIGHT.start)
    for _ in range(30):
        table.step(follower.step)
    pushed = Table(table.pose + np.array([0.0, 0.03, 0.0]))
    for _ in range(50):
        pushed.step(follower.step)
    assert follower.off_path
    assert follower.reference.at_rest
    assert pushed.pose[1] == pytest.approx(0.03, abs=0.004)


def test_a_paused_parcel_comes_to_rest_on_its_path_and_goes_on() -> None:
    follower, table = follower_of(STRAIGHT), Table(STRAIGHT.start)
    for _ in range(40):
        table.step(follower.step)
    follower.paused = True
    for _ in range(60):
        table.step(follower.step)
    assert follower.reference.at_rest
    assert abs(table.twist).max() < 0.005
    assert STRAIGHT.distance_m(STRAIGHT.off(table.pose, follower.reference.s_m)) < 0.005
    follower.paused = False
    for _ in range(150):
        table.step(follower.step)
    np.testing.assert_allclose(table.pose, STRAIGHT.end, atol=0.002)


def test_wheels_that_slip_push_less_and_the_parcel_arrives() -> None:
    grip = Grip()
    path = straight(np.array([-0.15, 0.0, 0.0]), np.array([0.15, 0.0, 0.0]), REACH_M)
    follower, table = follower_of(path, grip), Table(path.start, friction=0.1)
    for _ in range(250):
        table.step(follower.step)
    assert 1 <= grip.slips <= 4
    assert grip.share < 0.54
    np.testing.assert_allclose(table.pose, path.end, atol=0.003)
    # Another way, with the learned values.
    back = straight(table.pose, path.start, REACH_M)
    follower = follower_of(back, grip)
    slips, table.slipping, table.carrying = grip.slips, 0, 0
    for _ in range(300):
        table.step(follower.step)
    assert grip.slips == slips
    assert table.slipping < 0.02 * table.carrying


def test_wheels_that_gain_more_than_their_push_are_faster_by_as_much() -> None:
    path = straight(np.array([-0.15, 0.0, 0.0]), np.array([0.15, 0.0, 0.0]), REACH_M)
    follower, table = follower_of(path), Table(path.start, friction=0.08)
    faster_m_s = missing_m_s = 0.0
    for _ in range(12):
        table.step(follower.step)
        faster_m_s = float(table.rolling_twist()[0] - table.twist[0])
        if follower.gain is not None:
            missing_m_s += float(follower.gain.missing[0]) * STEP_S
    assert faster_m_s > 0.02
    assert missing_m_s == pytest.approx(faster_m_s, rel=0.35)


def test_rolling_wheels_gain_as_they_push() -> None:
    follower, table = follower_of(STRAIGHT), Table(STRAIGHT.start)
    sliding = Sliding(np.array([1.0, 1.0, 1.0 / REACH_M]))
    for _ in range(250):
        table.step(follower.step)
        if follower.gain is not None:
            sliding.step(follower.gain.missing, follower.gain.gained, STEP_S)
            assert not sliding.twist.any()


def test_a_change_of_speed_in_a_time_without_speeds_is_no_slip() -> None:
    follower, table = follower_of(STRAIGHT), Table(STRAIGHT.start)
    for _ in range(30):
        table.step(follower.step)
    last = table.belief()
    follower.step(last, STEP_S)
    # The wheels were braked meanwhile, where friction would not brake them within a cycle.
    belief = replace(last, twist=np.zeros(3), unseen=True)
    follower.step(belief, STEP_S)
    assert follower.gain is None
    for _ in range(20):
        follower.step(replace(belief, unseen=False), STEP_S)
    assert follower.grip.slips == 0


def test_wheels_that_drag_are_not_taken_for_wheels_that_slip() -> None:
    cells = (10,)
    traction = traction_of(speed_m_s=0.4)
    traction.lose(cells)
    path = straight(np.array([-0.15, 0.0, 0.0]), np.array([0.15, 0.0, 0.0]), REACH_M)
    follower = Follower(traction, traction.profile(path, BOX.footprint, mass_of(BOX)))
    table = Table(path.start, lost=cells)
    for _ in range(250):
        table.step(follower.step)
    assert follower.grip.slips == 0
    np.testing.assert_allclose(table.pose, path.end, atol=0.003)


def test_a_slow_gain_shows_no_slip() -> None:
    grip = Grip()
    for _ in range(50):
        grip.step(0.25, 0.1, 0.5, STEP_S)
    assert grip.slips == 0


def test_pushes_that_were_reduced_come_back_slowly() -> None:
    grip = Grip()
    for _ in range(20):
        grip.step(1.0, 0.4, 1.0, STEP_S)
    reduced = grip.share
    assert reduced < 0.6
    for _ in range(100):
        grip.step(0.0, 0.0, 1.0, STEP_S)
    assert reduced < grip.share < reduced + 0.05


@pytest.mark.parametrize("true_kg", [1.2, 3.0])
def test_a_parcel_of_another_mass_than_believed_arrives(true_kg: float) -> None:
    follower, table = follower_of(STRAIGHT, mass_kg=2.0), Table(STRAIGHT.start, mass_kg=true_kg)
    for _ in range(300):
        table.step(follower.step)
    np.testing.assert_allclose(table.pose, STRAIGHT.end, atol=0.002)
