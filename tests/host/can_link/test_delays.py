import gc
import os
import sys
from types import SimpleNamespace

import pytest

from mdms_host.can_link.delays import Delays, first_in_line, punctual
from mdms_host.clock import MonotonicClock


def test_nothing_is_said_of_cycles_and_frames_in_time():
    delays = Delays()
    for cycle in range(100):
        delays.on_arrival(cycle * 0.01)
        delays.on_cycle(cycle * 0.01, cycle * 0.01 + 0.005)
    assert delays.reason(1.0) is None


def test_a_late_cycle_is_the_reason_for_a_second():
    delays = Delays()
    delays.on_cycle(1.0, 1.08)
    assert "80 ms late" in delays.reason(1.5)
    assert delays.reason(2.5) is None


def test_a_bus_that_is_held_up_is_the_reason_while_it_lasts_and_for_a_second():
    delays = Delays()
    delays.on_arrival(1.0)
    assert delays.reason(1.02) is None
    assert "for 300 ms" in delays.reason(1.3)
    delays.on_arrival(1.4)
    assert "for 400 ms" in delays.reason(1.41)


def test_many_short_pauses_are_a_reason_together():
    delays = Delays()
    for pause in range(5):
        delays.on_arrival(1.0 + pause * 0.06)
        assert delays.reason(1.0 + pause * 0.06) is None or pause > 1
    assert "for 240 ms" in delays.reason(1.25)


def test_the_programs_own_lateness_goes_before_a_pause_that_follows_from_it():
    delays = Delays()
    delays.on_arrival(1.0)
    delays.on_cycle(1.01, 1.4)
    delays.on_arrival(1.4)
    assert "own cycle" in delays.reason(1.4)


def test_heartbeats_that_most_cells_send_too_late_are_the_reason_though_frames_come_in():
    """An array whose time passes at a third of its speed."""
    delays = Delays()
    for step in range(100):
        delays.on_arrival(step * 0.01)
        if step % 30 == 0:
            for node_id in range(1, 19):
                delays.on_heartbeat(node_id, step * 0.01)
    assert "came after 300 ms" in delays.reason(1.0)
    assert "served array" in delays.reason(1.0)


def test_one_cell_without_heartbeats_is_no_delay():
    delays = Delays()
    for step in range(100):
        delays.on_arrival(step * 0.01)
        for node_id in range(1, 19):
            if step % 10 == 0 and (node_id != 7 or step < 50):
                delays.on_heartbeat(node_id, step * 0.01)
    assert delays.reason(1.0) is None


def test_late_heartbeats_are_no_reason_after_a_second():
    delays = Delays()
    for time_s in (0.0, 0.3, *(0.4 + 0.1 * number for number in range(15))):
        for node_id in (1, 2, 3):
            delays.on_heartbeat(node_id, time_s)
        if time_s == 0.3:
            assert "came after 300 ms" in delays.reason(time_s)
    assert delays.reason(1.85) is None


def test_a_cycle_that_is_late_by_one_more_is_the_reason():
    delays = Delays()
    delays.on_cycle(1.0, 1.011)
    assert "11 ms late" in delays.reason(1.1)


class Machine:
    """Scheduling of one thread, for users with and without the right to change it."""

    SCHED_OTHER, SCHED_RR, SCHED_FIFO = 0, 2, 1

    def __init__(self, may: bool = True, policy: int = 0) -> None:
        self.policies = [policy]
        self._may = may

    def sched_getscheduler(self, _thread: int) -> int:
        return self.policies[-1]

    def sched_getparam(self, _thread: int) -> SimpleNamespace:
        return self.sched_param(0)

    def sched_param(self, priority: int) -> SimpleNamespace:
        return SimpleNamespace(sched_priority=priority)

    def sched_setscheduler(self, _thread: int, policy: int, _param: object) -> None:
        if not self._may:
            raise PermissionError
        self.policies.append(policy)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    machine = Machine()
    monkeypatch.setattr("mdms_host.can_link.delays.os", machine)
    return machine


def settings() -> tuple[float, int, bool]:
    return sys.getswitchinterval(), gc.get_freeze_count(), gc.isenabled()


def fail_in_time(machine: Machine, turn_s: float) -> None:
    with punctual(MonotonicClock()):
        assert sys.getswitchinterval() < turn_s
        assert gc.get_freeze_count() > 10_000
        assert machine.policies[-1] == machine.SCHED_RR
        raise KeyError


def test_all_is_as_before_when_a_run_is_over_though_it_failed(machine: Machine) -> None:
    gc.unfreeze()  # pytest's own have been frozen
    before = settings()
    with pytest.raises(KeyError):
        fail_in_time(machine, before[0])
    assert settings() == before
    assert machine.policies[-1] == machine.SCHED_OTHER


def test_time_that_is_not_the_machines_needs_nothing(machine: Machine) -> None:
    before = settings()
    with punctual(SimpleNamespace(is_real=False, now_s=lambda: 0.0, sleep=lambda _seconds: None)):
        assert settings() == before
    assert machine.policies == [machine.SCHED_OTHER]


def test_a_priority_that_was_given_already_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(policy=Machine.SCHED_FIFO)
    monkeypatch.setattr("mdms_host.can_link.delays.os", machine)
    with first_in_line():
        assert set(machine.policies) == {Machine.SCHED_FIFO}
    assert set(machine.policies) == {Machine.SCHED_FIFO}


@pytest.mark.parametrize("machine", [Machine(may=False), SimpleNamespace()], ids=["may not", "no"])
def test_a_thread_without_priority_runs_all_the_same(
    machine: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mdms_host.can_link.delays.os", machine)
    ran = False
    with first_in_line():
        ran = True
    assert ran


def test_the_machine_itself_takes_it_back() -> None:
    if not hasattr(os, "sched_getscheduler"):
        pytest.skip("no real-time priorities here")
    before = os.sched_getscheduler(0)
    with first_in_line():
        pass
    assert os.sched_getscheduler(0) == before
