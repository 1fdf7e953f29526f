"""What a run in real time asks of machine and interpreter, and that it gives all of it back."""

import gc
import os
import sys
from types import SimpleNamespace

import pytest

from mdms_host.can_link.delays import first_in_line, punctual
from mdms_host.clock import MonotonicClock


class Machine:
    """Scheduling of one thread, for who may change it and who may not."""

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
def test_who_may_not_come_first_runs_all_the_same(
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
