from tests.host.cells_link import CellsLink

from mdms_host.commissioning.stop import NetworkStop, StopReport, stop_all
from mdms_protocol.codecs import nmt
from mdms_protocol.codecs.frame import Frame


def test_the_command_is_sent_three_times_and_first_of_all() -> None:
    stopping, sent = NetworkStop(), []
    while not stopping.over:
        now_s = stopping.wake_s
        sent += [(now_s, frame) for frame in stopping.poll(now_s)]
    assert [frame for _, frame in sent] == [Frame(0x000, b"\x80\x00")] * 3
    assert sent[0][0] == 0.0


def test_a_cell_that_goes_on_is_named() -> None:
    stopping = NetworkStop()
    stopping.on_frame(Frame(0x704, b"\x05"), 0.0)
    stopping.on_frame(Frame(0x705, b"\x05"), 0.0)
    stopping.on_frame(Frame(0x704, b"\x7f"), 0.1)
    stopping.on_frame(Frame(0x706, b"\xff\xff"), 0.1)
    stopping.on_frame(Frame(0x77F, b"\x05"), 0.1)
    assert stopping.report == StopReport(heard=(4, 5), not_off=(5,))


def test_running_cells_are_stopped() -> None:
    link = CellsLink((1, 2, 3))
    link.send(nmt.command(nmt.START))
    link.sleep(0.2)
    assert set(link.states.values()) == {nmt.OPERATIONAL}
    assert stop_all(link, link) == StopReport(heard=(1, 2, 3), not_off=())
