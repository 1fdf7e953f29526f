import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.coordination.run_state import Schedule


def test_a_thing_is_due_once_a_period() -> None:
    schedule = Schedule()
    schedule.set("sync", 0.0)
    taken = [ms for ms in range(50) if schedule.take("sync", ms / 1000, 0.01)]
    assert taken == [0, 10, 20, 30, 40]


def test_a_time_that_was_never_set_or_was_cancelled_is_never_due() -> None:
    schedule = Schedule()
    schedule.set("sync", 1.0)
    schedule.cancel("sync")
    assert not schedule.take("sync", 1e9, 0.01)
    assert not schedule.take("setpoint", 1e9, 0.01)
    assert schedule.wake_s == float("inf")


@given(st.floats(0.0, 1000.0), st.floats(1e-3, 10.0))
def test_times_that_were_missed_are_left_out(late_s: float, period_s: float) -> None:
    schedule = Schedule()
    schedule.set("sync", 1.0)
    assert schedule.take("sync", 1.0 + late_s, period_s)
    following_s = schedule.next_s("sync")
    assert 1.0 + late_s < following_s <= 1.0 + late_s + period_s + 1e-6
    cycles = (following_s - 1.0) / period_s
    assert cycles == pytest.approx(round(cycles), abs=1e-6)
