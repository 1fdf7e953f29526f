import numpy as np
import pytest
from tests.host.motion.driving import BOX, Table, mass_of, traction_of

from mdms_host.motion.goal import GoalController, GoalPose
from mdms_host.motion.outcome import Standstill

STEP_S = 0.01


def controller_of(speed_m_s: float) -> GoalController:
    """Of a parcel that is to go 0.3 m."""
    traction = traction_of(speed_m_s=speed_m_s)
    return GoalController(GoalPose(0.15, 0.0, 0.0), traction, mass_of(BOX))


def reported_s(made_share: float, speed_m_s: float = 0.1, jump_m: float = 0.0) -> float | None:
    """When a parcel that makes this share of its commanded way is reported, within 3 s."""
    standstill, left_m = Standstill(), 1.0
    for step in range(1, 301):
        left_m -= made_share * speed_m_s * STEP_S
        left_m += jump_m if step == 100 else 0.0
        if standstill.step(left_m, speed_m_s, STEP_S):
            return step * STEP_S
    return None


def test_a_parcel_that_does_not_get_on_is_reported_within_a_second() -> None:
    for speed_m_s in (0.1, 0.01):
        time_s = reported_s(0.0, speed_m_s)
        assert time_s is not None
        assert time_s < 1.0


def test_a_parcel_that_slips_half_its_way_gets_on() -> None:
    assert reported_s(0.5) is None


def test_a_belief_that_an_edge_sets_back_does_not_stand() -> None:
    assert reported_s(1.0, jump_m=0.06) is None


def test_a_parcel_that_is_to_stand_is_not_reported() -> None:
    assert reported_s(0.0, speed_m_s=0.0) is None


@pytest.mark.parametrize("speed_m_s", [0.002, 0.1, 0.3])
def test_slow_and_fast_parcels_alike_get_on(speed_m_s: float) -> None:
    controller, standstill = controller_of(speed_m_s), Standstill()
    table = Table(np.array([-0.15, 0.0, 0.0]))
    for _ in range(600):
        table.step(controller.step)
        if controller.arrived:
            break
        assert not standstill.step(controller.left_m, controller.speed_m_s, STEP_S)


def test_a_belief_that_is_pulled_back_again_and_again_stands() -> None:
    controller, standstill, stood = controller_of(0.1), Standstill(), False
    for _ in range(10):
        # Each time it has made some way it is found to be where it was.
        table = Table(np.array([-0.15, 0.0, 0.0]))
        for _ in range(10):
            table.step(controller.step)
            stood |= standstill.step(controller.left_m, controller.speed_m_s, STEP_S)
    assert stood


def test_a_parcel_that_creeps_does_not_get_on_however_slow_it_is_to_be() -> None:
    time_s = reported_s(0.9, speed_m_s=0.0002)
    assert time_s is not None
    assert time_s < 2.0


def test_a_parcel_that_is_sent_elsewhere_has_not_stood() -> None:
    standstill = Standstill()
    for step in range(60):
        assert not standstill.step(0.1 - 0.001 * step, 0.1, STEP_S)
    for step in range(60):
        assert not standstill.step(0.3 - 0.001 * step, 0.1, STEP_S, leg=1)
