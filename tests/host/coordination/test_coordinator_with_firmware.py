"""The coordinator with the cells' real firmware in virtual time, on a wire that may lose frames."""

from collections.abc import Callable

import numpy as np
import pytest

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import Phase
from mdms_host.layout import Layout
from mdms_host.motion.program import FieldProgram
from mdms_protocol import pdo
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank

LAYOUT = Layout(3, 1)


def run(
    coordinator: Coordinator,
    until: Callable[[], bool],
    lost: Callable[[Frame], bool] = lambda _frame: False,
    presence: Callable[[int], int] = lambda _now_ms: 0,
) -> None:
    """A millisecond at a time, until it is so; three seconds at most."""
    bank = PythonBank(LAYOUT.node_ids)
    counts = np.zeros((LAYOUT.cells, 2), np.int32)
    for now_ms in range(3000):
        bank.tick(counts, np.zeros_like(counts), np.full(LAYOUT.cells, presence(now_ms), np.uint8))
        for cell in range(LAYOUT.cells):
            for frame in bank.collect(cell):
                if not lost(frame):
                    coordinator.on_frame(frame, now_ms / 1000)
        if coordinator.wake_s <= now_ms / 1000:
            for frame in coordinator.poll(now_ms / 1000):
                for cell in range(LAYOUT.cells):
                    if not lost(frame) and frame.can_id in bank.accepts(cell):
                        bank.deliver(cell, frame)
        if until():
            return
    raise AssertionError(f"not so after 3 s; {coordinator.events}")


def moving() -> Coordinator:
    return Coordinator(LAYOUT, FieldProgram(np.full(6, 0.05)))


class Losing:
    """Loses the first so many frames of a kind."""

    def __init__(self, can_id: int, count: int) -> None:
        self.can_id, self.left = can_id, count

    def __call__(self, frame: Frame) -> bool:
        lose = frame.can_id == self.can_id and self.left > 0
        self.left -= lose
        return lose


def test_cells_come_up_and_go_down() -> None:
    coordinator = moving()

    def until() -> bool:
        if coordinator.phase == Phase.RUNNING:
            coordinator.stop()
        return coordinator.stopped

    run(coordinator, until)
    assert coordinator.fault is None
    assert not any(cell.moving for cell in coordinator.cells)


@pytest.mark.parametrize(
    ("can_id", "count"),
    [
        (0x000, 4),
        (pdo.STATUS.can_id(2), 2),
        (pdo.CONTROLWORD.can_id(2), 2),
        (0x602, 2),
        (0x582, 2),
        (0x702, 2),
    ],
)
def test_lost_frames_only_delay_the_start(can_id: int, count: int) -> None:
    coordinator, losing = moving(), Losing(can_id, count)
    run(coordinator, lambda: coordinator.phase == Phase.RUNNING, losing)
    assert losing.left == 0


def test_a_lost_change_of_presence_is_made_good() -> None:
    coordinator = moving()
    losing = Losing(pdo.STATUS.can_id(2), 0)

    def presence(now_ms: int) -> int:
        if coordinator.phase != Phase.RUNNING or now_ms < 1000:
            return 0
        if now_ms == 1000:
            losing.left = 1
        return 0b10110

    run(coordinator, lambda: coordinator.cells[1].presence == 0b10110, losing, presence)
    assert losing.left == 0
