"""A cell that the table tells its place starts nowhere else."""

from cell_bench import NODE, booted, emergencies

from mdms_cell.cell import Cell
from mdms_protocol.codecs import nmt

ELSEWHERE = NODE + 1
START = bytes((nmt.START, NODE))
NMT_STATES = (nmt.STOP, nmt.ENTER_PRE_OPERATIONAL)


def told(place):
    """A cell that boots where the node of this id belongs."""
    cell, board = booted()
    board.place_code = place
    board.take()
    cell = Cell(board, NODE)
    cell.poll(0)
    cell.poll(50)
    return cell, board


def start(cell, board):
    """Start the cell, and let it send what it has to say."""
    cell.on_frame(0x000, START, cell.now_ms)
    cell.poll(cell.now_ms + 1)
    return emergencies(board)


def test_a_table_that_tells_nothing_is_no_obstacle():
    cell, board = told(0)
    assert start(cell, board) == []
    assert cell.state == nmt.OPERATIONAL


def test_a_cell_in_its_own_place_starts():
    cell, board = told(NODE)
    assert start(cell, board) == []
    assert cell.state == nmt.OPERATIONAL


def test_a_cell_in_anothers_place_says_so_at_its_boot_and_at_each_start():
    cell, board = told(ELSEWHERE)
    cell.poll(51)
    said = emergencies(board)
    assert said == [bytes((0x02, 0xFF, 0x81, 10, ELSEWHERE, 0, 0, 0))]
    for _ in range(2):
        assert start(cell, board) == said
        assert cell.state == nmt.PRE_OPERATIONAL


def test_it_obeys_all_other_commands_there():
    cell, board = told(ELSEWHERE)
    for command in NMT_STATES:
        cell.on_frame(0x000, bytes((command, NODE)), cell.now_ms)
        assert cell.state == nmt.TRANSITIONS[command]
        start(cell, board)
        assert cell.state == nmt.TRANSITIONS[command]
    cell.on_frame(0x000, bytes((nmt.RESET_NODE, NODE)), cell.now_ms)
    assert cell.state == nmt.INITIALISING


def test_refused_starts_leave_the_history_and_other_messages_alone():
    cell, board = told(ELSEWHERE)
    cell.fail(0x6100)
    cell.on_frame(0x000, bytes((nmt.STOP, NODE)), cell.now_ms)
    for _ in range(20):
        cell.on_frame(0x000, START, cell.now_ms)
    cell.on_frame(0x000, bytes((nmt.ENTER_PRE_OPERATIONAL, NODE)), cell.now_ms)
    for _ in range(8):
        cell.poll(cell.now_ms + 1)
    codes = [data[0] | data[1] << 8 for data in emergencies(board)]
    assert 0x6100 in codes
    assert cell._objects.number(0x1003, 0) == 1
    assert cell._objects.number(0x1003, 1) & 0xFFFF == 0x6100


def test_it_starts_once_it_is_put_back():
    cell, board = told(ELSEWHERE)
    start(cell, board)
    board.place_code = NODE
    assert start(cell, board) == [bytes((0, 0, 0, 10, 0, 0, 0, 0))]
    assert cell.state == nmt.OPERATIONAL


def test_a_cell_that_runs_looks_at_its_next_start():
    cell, board = told(NODE)
    start(cell, board)
    board.place_code = ELSEWHERE
    cell.poll(200)
    assert start(cell, board) == []
    assert cell.state == nmt.OPERATIONAL
    cell.on_frame(0x000, bytes((nmt.ENTER_PRE_OPERATIONAL, NODE)), cell.now_ms)
    start(cell, board)
    assert cell.state == nmt.PRE_OPERATIONAL
