"""Runs on firmware cells, with bus and clock in virtual time: no machine is too slow for them."""

from collections import deque
from collections.abc import Callable

import numpy as np
import pytest

from mdms_host.can_link.link import Link
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.operation import Ending, operate
from mdms_host.coordination.phase import Phase
from mdms_host.coordination.schedule import Timing
from mdms_host.layout import Layout
from mdms_host.motion.program import FieldProgram
from mdms_protocol import cob, nmt
from mdms_protocol.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank

LAYOUT = Layout(3, 1)
TICK_S = 0.001
#: A link waits for a frame no longer than this, whatever it is asked for.
READ_TIMEOUT_S = 0.1


class CellsLink(Link):
    """A link whose cells live through exactly the time that the host waits in `receive`.

    Nothing lies on the cells, and no wheel turns. Left out: a device that fails.
    """

    def __init__(self, node_ids: tuple[int, ...]) -> None:
        self.states: dict[int, int] = {}
        self._bank = PythonBank(node_ids)
        self._counts = np.zeros((len(node_ids), 2), np.int32)
        self._presence = np.zeros(len(node_ids), np.uint8)
        self._ticks = 0
        self._now_s = 0.0
        self._waiting: deque[tuple[Frame, float]] = deque()
        while len(self.states) < len(node_ids):
            self._now_s = self._ticks * TICK_S
            self._tick()
        self._waiting.clear()

    def power_off(self) -> None:
        for cell in range(len(self._counts)):
            self._bank.power_off(cell)

    def now_s(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        self._pass_until(self._now_s + seconds, lambda: False)

    def send(self, frame: Frame) -> None:
        for cell in range(len(self._counts)):
            self._bank.deliver(cell, frame)

    def receive(self, timeout_s: float, handle: Callable[[Frame, float], object]) -> None:
        wait_s = max(0.0, min(timeout_s, READ_TIMEOUT_S))
        self._pass_until(self._now_s + wait_s, lambda: bool(self._waiting))
        for _ in range(len(self._waiting)):
            handle(*self._waiting.popleft())

    def close(self) -> None:
        self._waiting.clear()

    def _pass_until(self, end_s: float, over: Callable[[], bool]) -> None:
        while not over() and self._now_s < end_s:
            next_s = self._ticks * TICK_S
            self._now_s = min(end_s, next_s)
            if next_s <= end_s:
                self._tick()

    def _tick(self) -> None:
        self._bank.tick(self._counts, np.zeros_like(self._counts), self._presence)
        self._ticks += 1
        for _, frames in self._bank.collect_all():
            for frame in frames:
                self._waiting.append((frame, self._now_s))
                node_id = frame.can_id - cob.HEARTBEAT_BASE
                if 0 < node_id < cob.NODE_MAX:
                    self.states[node_id] = frame.data[0]


@pytest.fixture
def link() -> CellsLink:
    return CellsLink((1, 2, 3))


def coordinator(timing: Timing | None = None) -> Coordinator:
    return Coordinator(LAYOUT, FieldProgram(np.full(6, 0.05)), timing=timing)


def test_a_field_runs_for_its_time_on_real_cells_and_leaves_them_off(link) -> None:
    heard, one = [], coordinator()
    done = operate(one, link, link, 2.0, tell=lambda _now_s, text: heard.append(text))
    assert (done.ending, done.fault) == (Ending.DONE, None)
    assert done.duration_s >= 2.0
    assert Phase.RUNNING in heard
    assert heard[-1] == Phase.STOPPED
    assert not any(cell.moving for cell in one.cells)


def test_an_interrupt_ends_in_order(link) -> None:
    one = coordinator()

    def interrupt(_now_s: float, text: str) -> None:
        if text == Phase.RUNNING:
            raise KeyboardInterrupt

    done = operate(one, link, link, 10.0, tell=interrupt)
    assert done.ending == Ending.INTERRUPTED
    assert one.phase == Phase.STOPPED


def test_an_array_of_no_cells_is_told_as_such(link) -> None:
    link.power_off()
    done = operate(coordinator(Timing(phase_limit_s=0.2)), link, link, 10.0)
    assert done.ending == Ending.NO_CELLS


def test_a_missing_cell_is_a_fault(link) -> None:
    one = Coordinator(Layout(4, 1), FieldProgram(np.zeros(8)), timing=Timing(phase_limit_s=0.5))
    done = operate(one, link, link, 10.0)
    assert done.ending == Ending.FAULT
    assert done.fault == "not heard within 0.5 s: cell 4 (node 4)"


def test_a_second_run_takes_the_array_over_from_one_that_broke_off(link) -> None:
    class BrokenOffError(Exception):
        pass

    def break_off(_now_s: float, text: str) -> None:
        if text == Phase.RUNNING:
            raise BrokenOffError

    with pytest.raises(BrokenOffError):
        operate(coordinator(), link, link, 10.0, tell=break_off)
    link.sleep(0.3)
    assert set(link.states.values()) == {nmt.OPERATIONAL}
    assert operate(coordinator(), link, link, 1.5).ending == Ending.DONE
