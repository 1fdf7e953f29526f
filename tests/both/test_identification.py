"""A cell shows which one it is (0x3007), for as long as it was asked to."""

from cell_bench import Board, booted

from mdms_cell.cell import Cell
from mdms_protocol.codecs import nmt, sdo

REMAINING = b"\x4b\x07\x30\x00"


class Lit(Board):
    def __init__(self):
        super().__init__()
        self.lit = False

    def blink(self, on):
        self.lit = on


def lit_cell():
    board = Lit()
    cell = Cell(board, 5)
    cell.poll(0)
    cell.poll(50)
    return cell, board


def ask(cell, time_ms):
    cell.on_frame(0x605, sdo.write_request(0x3007, 0, time_ms.to_bytes(2, "little")), cell.now_ms)


def left(cell, board):
    board.take()
    cell.on_frame(0x605, sdo.read_request(0x3007, 0), cell.now_ms)
    _, data = board.take()[-1]
    assert data[:4] == REMAINING
    return data[4] | data[5] << 8


def test_leds_blink_until_the_time_is_over_though_nobody_ends_it():
    cell, board = lit_cell()
    ask(cell, 3000)
    assert board.lit
    cell.poll(3049)
    assert board.lit
    assert left(cell, board) == 1
    cell.poll(3050)
    assert not board.lit
    assert left(cell, board) == 0


def test_asked_again_it_counts_from_then_on():
    cell, board = lit_cell()
    ask(cell, 1000)
    cell.poll(600)
    ask(cell, 1000)
    cell.poll(1500)
    assert board.lit
    cell.poll(1600)
    assert not board.lit


def test_zero_ends_it_and_so_does_a_reset():
    cell, board = lit_cell()
    ask(cell, 60_000)
    ask(cell, 0)
    assert not board.lit
    ask(cell, 60_000)
    cell.on_frame(0x000, bytes((nmt.RESET_NODE, 5)), cell.now_ms)
    assert not board.lit


def test_a_cell_whose_node_id_is_taken_does_not_blink_for_ever():
    cell, board = lit_cell()
    ask(cell, 500)
    cell.on_frame(0x000, bytes((nmt.RESET_COMMUNICATION, 5)), cell.now_ms)
    cell.poll(51)
    cell.on_frame(0x705, b"\x7f", cell.now_ms)
    cell.poll(549)
    assert (cell.state, board.lit) == (nmt.INITIALISING, True)
    cell.poll(550)
    assert not board.lit


def test_a_cell_that_blinks_is_polled_when_its_time_is_over_and_drives_nothing():
    cell, board = lit_cell()
    ask(cell, 70)
    cell.poll(50)
    assert cell.wake_ms <= 120
    assert board.registers[1] == 0


def test_a_board_without_leds_takes_the_request_too():
    cell, board = booted()
    ask(cell, 500)
    assert left(cell, board) == 500
