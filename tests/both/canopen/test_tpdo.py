"""Transmit PDOs after long silence: instants further back than the clock can tell apart."""

from cell_bench import emergencies, operational

from mdms_cell import ticks
from mdms_protocol.codecs import sdo

DAY_MS = 86_400_000
INHIBIT_10_MS = (0x1801, 3, b"\x64\x00")
EMCY_INHIBIT_10_MS = (0x1015, 0, b"\x64\x00")


def slept(days, *settings):
    """A cell to which nothing has happened for days but its status sent once, and the time."""
    cell, board = operational()
    cell.on_frame(0x000, b"\x80\x05", cell.now_ms)
    cell.on_frame(0x605, sdo.write_request(0x1801, 1, b"\x85\x02\0\x80"), cell.now_ms)
    for setting in settings:
        cell.on_frame(0x605, sdo.write_request(*setting), cell.now_ms)
    cell.on_frame(0x605, sdo.write_request(0x1801, 1, b"\x85\x02\0\x40"), cell.now_ms)
    cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
    cell.fail(0x8140)
    now_ms = 50
    for _ in range(days):
        now_ms = ticks.after(now_ms, DAY_MS)
        cell.poll(now_ms)
    board.take()
    return cell, board, ticks.after(now_ms, DAY_MS)


def test_change_after_days_of_nothing_is_sent_at_once():
    for days in (1, 7, 13):
        for settings in ((), (INHIBIT_10_MS,)):
            cell, board, now_ms = slept(days, *settings)
            board.bits = 0b101
            cell.poll(now_ms)
            cell.poll(ticks.after(now_ms, 4))
            assert [data[4] for can_id, data in board.take() if can_id == 0x285] == [0b101]


def test_acyclic_change_that_was_refused_is_sent_within_a_few_milliseconds():
    cell, board = operational()
    cell.on_frame(0x605, sdo.write_request(0x1800, 2, b"\0"), cell.now_ms)
    board.take()
    send = board.send
    board.send = lambda can_id, data: False
    cell.on_frame(0x080, b"", cell.now_ms)
    cell.poll(51)
    board.send = send
    for now_ms in range(52, 51 + ticks.RETRY_MS + 1):
        cell.poll(now_ms)
    assert [frame for frame in board.take() if frame[0] == 0x185] == [(0x185, bytes(8))]


def test_emergency_after_days_of_nothing_is_sent_at_once():
    for days in (1, 7, 13):
        cell, board, now_ms = slept(days, EMCY_INHIBIT_10_MS)
        cell.recover()
        cell.poll(now_ms)
        assert emergencies(board) == [b"\x00\x00\x00\x06\0\0\0\0"]


def test_pdo_of_the_layer_is_sent_by_nothing_else():
    cell, board = operational()
    board.bits = 0b1
    for now_ms in range(cell.now_ms, cell.now_ms + 2000, 5):
        cell.on_frame(0x080, b"", now_ms)
        cell.poll(now_ms)
    assert not [can_id for can_id, _ in board.take() if can_id in (0x385, 0x485)]
    cell.on_frame(0x47F, bytes(range(8)), cell.now_ms)
    assert cell.dropped == 0
    cell.on_frame(0x605, sdo.read_request(0x3022, 2), cell.now_ms)
    assert board.take() == [(0x585, b"\x43\x22\x30\x02\x04\x05\x06\x07")]
