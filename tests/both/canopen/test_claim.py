"""How a cell comes by its node id, and its report when another node has it."""

from cell_bench import NODE, Board, booted, enable

from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop
from mdms_protocol.codecs import cob, nmt, sdo


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
        cell.on_frame(can_id, data, cell.now_ms)
        for now_ms in range(1, 500):
            cell.poll(now_ms)
        assert board.take() == [(0x085, b"\x50\x81\x11\x05\0\0\0\0")]
        cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
        enable(cell)
        cell.tick()
        assert cell.state == nmt.INITIALISING
        assert board.registers[speed_loop.MODE] == speed_loop.OFF


def test_node_id_is_claimed_again_after_a_reset():
    cell, board = claiming()
    cell.on_frame(0x705, b"\x05", cell.now_ms)
    cell.poll(100)
    board.take()
    cell.on_frame(0x000, b"\x82\x00", cell.now_ms)
    cell.poll(200)
    cell.poll(250)
    cell.poll(251)
    assert [can_id for can_id, _ in board.take()] == [0x605, 0x705, 0x085]


def test_host_that_reads_the_serial_number_is_no_rival():
    cell, board = claiming()
    cell.on_frame(0x605, b"\x40\x18\x10\x04\x00\x00\x00\x00", cell.now_ms)
    cell.poll(50)
    assert board.take() == [(0x705, b"\x00")]


def test_cell_without_node_id_is_silent_until_it_gets_one():
    board = Board()
    cell = Cell(board, cob.NODE_NONE)
    for now_ms in range(100):
        cell.poll(now_ms)
    assert board.take() == []
    assert list(cell.accepts) == [0x7E5]
    cell.on_frame(0x7E5, b"\x04\x01\0\0\0\0\0\0", cell.now_ms)
    cell.on_frame(0x7E5, b"\x11\x07\0\0\0\0\0\0", cell.now_ms)
    cell.on_frame(0x7E5, b"\x04\x00\0\0\0\0\0\0", cell.now_ms)
    cell.poll(100)
    cell.poll(150)
    assert board.take()[-1] == (0x707, b"\x00")


CLAIM = b"\x40\x18\x10\x04\x09\x00\x00\x00"


def test_claim_of_a_duplicate_leaves_a_transfer_alone_and_is_answered_with_a_heartbeat():
    transfers = (
        (b"\x40\x09\x10\x00\0\0\0\0", b"\x60\0\0\0\0\0\0\0", b"\x002 wheel"),
        (b"\x21\x00\x30\x00\x02\0\0\0", b"\x0b\x4d\x00\0\0\0\0\0", b"\x20" + bytes(7)),
        (b"\xc2\x00\x30\x00\x02\0\0\0", b"\x81\x4d\x00\0\0\0\0\0", b"\xa2\x01\x3f" + bytes(5)),
    )
    for first, second, answer in transfers:
        cell, board = booted()
        cell.on_frame(0x605, first, cell.now_ms)
        board.take()
        cell.on_frame(0x605, CLAIM, cell.now_ms)
        cell.poll(51)
        assert board.take() == [(0x705, b"\x7f")]
        cell.on_frame(0x605, second, cell.now_ms)
        assert board.take() == [(0x585, answer)]


def test_claim_is_answered_by_a_stopped_cell_and_when_there_is_room_again():
    cell, board = booted()
    cell.on_frame(0x000, b"\x02\x05", cell.now_ms)
    send = board.send
    board.send = lambda can_id, data: False
    cell.on_frame(0x605, CLAIM, cell.now_ms)
    cell.poll(51)
    board.send = send
    for now_ms in range(52, 57):
        cell.poll(now_ms)
    assert board.take() == [(0x705, b"\x04")]


def test_claim_is_answered_like_any_request_while_there_is_no_transfer():
    cell, board = booted()
    cell.on_frame(0x605, CLAIM, cell.now_ms)
    assert board.take() == [(0x585, b"\x43\x18\x10\x04\x05\0\0\0")]


def test_client_that_reads_the_serial_number_takes_the_place_of_a_transfer():
    cell, board = booted()
    cell.on_frame(0x605, b"\x40\x09\x10\x00\0\0\0\0", cell.now_ms)
    board.take()
    cell.on_frame(0x605, sdo.read_request(0x1018, 4), cell.now_ms)
    assert board.take() == [(0x585, b"\x43\x18\x10\x04\x05\0\0\0")]


def test_duplicate_that_boots_amid_a_transfer_does_not_take_the_node_id():
    legitimate, board = booted()
    legitimate.on_frame(0x605, b"\x40\x09\x10\x00\0\0\0\0", legitimate.now_ms)
    board.take()
    other = Board()
    other.serial = 9
    duplicate = Cell(other, NODE)
    for now_ms in range(51, 200):
        legitimate.poll(now_ms)
        duplicate.poll(now_ms)
        for can_id, data in board.take():
            duplicate.on_frame(can_id, data, duplicate.now_ms)
        for can_id, data in other.take():
            legitimate.on_frame(can_id, data, legitimate.now_ms)
    assert duplicate.state == nmt.INITIALISING
    assert legitimate.state == nmt.PRE_OPERATIONAL
    legitimate.on_frame(0x605, b"\x60\0\0\0\0\0\0\0", legitimate.now_ms)
    assert board.take() == [(0x585, b"\x002 wheel")]
