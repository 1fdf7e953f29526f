"""A recorder keeps the data of a run that the coordinator saw, and no more."""

import numpy as np
import pytest

from mdms_array.host import coordinator_of, estimates_of
from mdms_array.recording import PlanLog
from mdms_host.coordination.recorder import Recorder
from mdms_host.programs.traffic.dispatch import DELAY_CYCLES
from mdms_model.run.record import Contact, Event
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import simulate


@pytest.fixture(scope="module")
def recorded():
    """The record with its plans, the frames that were logged, and the simulation's own outcome."""
    scenario = load_scenario("array18", ["run.duration_s=1.5", "motion.speed_m_s=0.1"])
    coordinator, frames = coordinator_of(scenario), []
    plans = PlanLog(coordinator)
    recorder = Recorder(
        coordinator,
        lambda: estimates_of(coordinator, scenario),
        lambda *each: frames.append(each),
        look=plans.look,
    )
    outcome = simulate(scenario, [recorder])
    record = recorder.record([(0.5, "garbage")])
    record.plans = plans.plans
    return record, frames, outcome


def test_truth_is_left_out(recorded):
    record, _, _ = recorded
    assert record.is_belief
    for name in ("pose", "twist", "voltage_v", "normal_n", "force_n"):
        assert np.isnan(getattr(record, name)).all(), name
    assert set(record.contact.ravel().tolist()) == {Contact.UNKNOWN}


def test_estimates_references_and_speeds_are_those_of_the_run(recorded):
    record, _, outcome = recorded
    assert np.isnan(record.estimate[0]).all()
    np.testing.assert_allclose(record.estimate[-1], outcome.record.pose[-1], atol=0.01)
    assert np.abs(record.reference_m_s[-1]).max() > 0.05
    speeds_m_s = outcome.record.speed_m_s[-1]
    np.testing.assert_allclose(record.speed_m_s[-1], speeds_m_s, atol=0.01)


def test_samples_keep_their_rate(recorded):
    record, _, _ = recorded
    # In the phases without setpoints the coordinator is seldom polled.
    assert np.diff(record.time_s)[-50:] == pytest.approx(0.01, abs=0.006)


def test_every_frame_is_logged_of_any_sender(recorded):
    _, frames, outcome = recorded
    assert len(frames) == pytest.approx(outcome.bus.frames, abs=20)


def test_events_of_coordinator_and_link_are_in_order_of_time(recorded):
    record, _, _ = recorded
    assert Event(0.5, "link", "garbage") in record.events
    assert "running" in [event.detail for event in record.events]
    times_s = [event.time_s for event in record.events]
    assert times_s == sorted(times_s)


def test_sensors_are_as_the_cells_reported_them(recorded):
    record, _, outcome = recorded
    # Only a sample between a status and its recording differs.
    differs = (record.presence[-1] != outcome.record.presence[-1]).sum()
    assert record.presence[-1].any()
    assert differs <= 1


def test_goal_and_way_of_a_parcel_that_the_host_steers_are_kept_as_planned(recorded):
    record, _, outcome = recorded
    goals, under_way, *again = record.plans
    # The tiles that it has left are no longer reserved.
    assert np.diff([plan.time_s for plan in (under_way, *again)]) == pytest.approx(0.5, abs=0.02)
    assert len(again[-1].tiles) < len(under_way.tiles)
    assert goals.goals["box"] == pytest.approx((0.1, 0.0, np.pi / 6))
    assert goals.ways == {}
    way, due_s = under_way.ways["box"], under_way.due_s["box"]
    assert way[0] == pytest.approx(outcome.record.pose[0, 0], abs=0.01)
    assert way[-1] == pytest.approx(goals.goals["box"])
    # Its times are those for which the plan was asked.
    assert under_way.time_s - due_s[0] == pytest.approx(0.01 * DELAY_CYCLES)
    assert (np.diff(due_s) > 0).all()
    # 0.2 m at 0.1 m/s, a corner's way included.
    assert 2.0 < due_s[-1] - due_s[0] < 4.0
