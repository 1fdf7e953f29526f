"""How a cell comes by its node id, and what it says when somebody else has it."""

from cell_bench import NODE, Board, enable

from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop
from mdms_protocol import cob, nmt


def test_boot_up_comes_when_nobody_claims_the_node_id_within_50_ms():
    board = Board()
    cell = Cell(board, NODE)
    cell.poll(0)
    assert board.take() == [(0x605, b"\x40\x18\x10\x04\x05\x00\x00\x00")]
    for now_ms in range(1, 50):
        cell.poll(now_ms)
    assert board.take() == []
    cell.poll(50)
    assert board.take() == [(0x705, b"\x00")]


def claiming(board=None, node_id=NODE):
    board = board or Board()
    cell = Cell(board, node_id)
    cell.poll(0)
    board.take()
    return cell, board


def test_node_id_that_answers_is_not_taken_and_that_is_reported():
    answers = (
        (0x585, b"\x43\x18\x10\x04\x01\x00\x00\x00"),
        (0x705, b"\x05"),
        (0x605, b"\x40\x18\x10\x04\x09\x00\x00\x00"),
    )
    for can_id, data in answers:
        cell, board = claiming()
        cell.on_frame(can_id, data)
        for now_ms in range(1, 500):
            cell.poll(now_ms)
        assert board.take() == [(0x085, b"\x50\x81\x11\x05\0\0\0\0")]
        cell.on_frame(0x000, b"\x01\x05")
        enable(cell)
        cell.tick()
        assert cell.state == nmt.INITIALISING
        assert board.registers[speed_loop.MODE] == speed_loop.OFF


def test_node_id_is_claimed_again_after_a_reset():
    cell, board = claiming()
    cell.on_frame(0x705, b"\x05")
    cell.poll(100)
    board.take()
    cell.on_frame(0x000, b"\x82\x00")
    cell.poll(200)
    cell.poll(250)
    cell.poll(251)
    assert [can_id for can_id, _ in board.take()] == [0x605, 0x705, 0x085]


def test_host_that_reads_the_serial_number_is_no_rival():
    cell, board = claiming()
    cell.on_frame(0x605, b"\x40\x18\x10\x04\x00\x00\x00\x00")
    cell.poll(50)
    assert board.take() == [(0x705, b"\x00")]


def test_cell_without_node_id_is_silent_until_it_gets_one():
    board = Board()
    cell = Cell(board, cob.NODE_NONE)
    for now_ms in range(100):
        cell.poll(now_ms)
    assert board.take() == []
    assert list(cell.accepts) == [0x7E5]
    cell.on_frame(0x7E5, b"\x04\x01\0\0\0\0\0\0")
    cell.on_frame(0x7E5, b"\x11\x07\0\0\0\0\0\0")
    cell.on_frame(0x7E5, b"\x04\x00\0\0\0\0\0\0")
    cell.poll(100)
    cell.poll(150)
    assert board.take()[-1] == (0x707, b"\x00")
