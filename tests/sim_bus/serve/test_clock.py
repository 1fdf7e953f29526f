"""Real time whose speed changes, on a machine whose clock is scripted."""

import pytest

from mdms_sim.serve import clock
from mdms_sim.serve.clock import LOOK_S, PATIENCE_NS, RealTime

MS = 1_000_000


@pytest.fixture
def machine(monkeypatch):
    """The machine's clock: `machine[0]` is its time [ns]."""
    now_ns = [5_000 * MS]
    monkeypatch.setattr(clock.time, "monotonic_ns", lambda: now_ns[0])
    return now_ns


def test_time_stands_still_and_goes_on_where_it_stood(machine):
    time = RealTime()
    machine[0] += 10 * MS
    assert time.sim_ns(10 * MS) == 10 * MS
    time.change_speed(0.0, 10 * MS)
    machine[0] += 1000 * MS
    assert time.sim_ns(10 * MS) == 10 * MS
    assert time.wait_s(11 * MS, 10 * MS) == LOOK_S
    time.change_speed(1.0, 10 * MS)
    machine[0] += 5 * MS
    assert time.sim_ns(10 * MS) == 15 * MS
    assert time.late_ns == 0


def test_new_speed_counts_from_now(machine):
    time = RealTime()
    machine[0] += 10 * MS
    time.change_speed(0.5, time.sim_ns(10 * MS))
    machine[0] += 10 * MS
    assert time.sim_ns(10 * MS) == 15 * MS
    assert time.wait_s(16 * MS, 15 * MS) == pytest.approx(0.002)


def test_time_given_up_before_is_not_made_up_for_after_a_change(machine):
    time = RealTime()
    machine[0] += 100 * MS
    assert time.sim_ns(0) == PATIENCE_NS
    time.change_speed(1.0, PATIENCE_NS)
    machine[0] += 1 * MS
    assert time.sim_ns(PATIENCE_NS) == PATIENCE_NS + MS
    assert time.late_ns == 100 * MS - PATIENCE_NS


def test_time_that_nearly_stands_keeps_nobody_from_what_else_is_to_do(machine):
    assert RealTime(1e-9).wait_s(MS, 0) == LOOK_S
