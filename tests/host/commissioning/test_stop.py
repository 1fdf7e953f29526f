import pytest

from mdms_host.can_link.link import Link
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.stop import StopAll, StopReport, stop_all
from mdms_protocol import nmt
from mdms_protocol.frame import Frame

pytestmark = pytest.mark.real_time


def test_the_command_is_sent_three_times_and_first_of_all() -> None:
    stopping, sent = StopAll(), []
    while not stopping.over:
        now_s = stopping.wake_s
        sent += [(now_s, frame) for frame in stopping.poll(now_s)]
    assert [frame for _, frame in sent] == [Frame(0x000, b"\x80\x00")] * 3
    assert sent[0][0] == 0.0


def test_a_cell_that_goes_on_is_named() -> None:
    stopping = StopAll()
    stopping.on_frame(Frame(0x704, b"\x05"), 0.0)
    stopping.on_frame(Frame(0x705, b"\x05"), 0.0)
    stopping.on_frame(Frame(0x704, b"\x7f"), 0.1)
    stopping.on_frame(Frame(0x706, b"\xff\xff"), 0.1)
    stopping.on_frame(Frame(0x77F, b"\x05"), 0.1)
    assert stopping.report == StopReport(heard=(4, 5), not_off=(5,))


def test_running_cells_are_stopped(served_cells) -> None:
    clock = MonotonicClock()
    with Link(served_cells.open(), clock) as link:
        link.send(nmt.command(nmt.START))
        clock.sleep(0.2)
        assert stop_all(link, clock) == StopReport(heard=(1, 2, 3), not_off=())
