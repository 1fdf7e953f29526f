"""The reaction of a cell when a node falls silent, a frame is missing, or its node id is taken."""

from cell_bench import emergencies, enable, operational

from mdms_cell.drive import speed_loop
from mdms_cell.runner import BUS_OFF
from mdms_protocol.codecs import nmt, sdo


def watching():
    """A cell that watches the host's heartbeat, node 127, with its motors on."""
    cell, board = operational()
    cell.on_frame(0x605, sdo.write_request(0x1016, 1, b"\xc8\x00\x7f\x00"), cell.now_ms)
    enable(cell)
    board.take()
    return cell, board


def test_lost_heartbeat_of_the_host_switches_the_motors_off():
    cell, board = watching()
    for now_ms in range(51, 600):
        cell.on_frame(0x205, bytes(8), cell.now_ms)
        cell.on_frame(0x080, b"", cell.now_ms)
        cell.tick()
        cell.poll(now_ms)
        if now_ms <= 300 and now_ms % 100 == 0:
            cell.on_frame(0x77F, b"\x05", cell.now_ms)
        driven = board.registers[speed_loop.MODE] == speed_loop.RUN
        assert driven == (now_ms < 500)
    assert cell.state == nmt.PRE_OPERATIONAL
    assert emergencies(board) == [b"\x30\x81\x11\x03\0\0\0\0"]
    cell.on_frame(0x77F, b"\x05", cell.now_ms)
    cell.poll(605)
    assert emergencies(board) == [b"\x00\x00\x00\x03\0\0\0\0"]


def test_error_behaviour_chooses_the_state():
    for behaviour, state in ((0, nmt.PRE_OPERATIONAL), (1, nmt.OPERATIONAL), (2, nmt.STOPPED)):
        cell, board = watching()
        cell.on_frame(0x605, sdo.write_request(0x1029, 1, bytes((behaviour,))), cell.now_ms)
        cell.on_frame(0x77F, b"\x05", cell.now_ms)
        for now_ms in range(51, 300):
            cell.poll(now_ms)
        assert cell.state == state
        assert board.registers[speed_loop.MODE] == speed_loop.BRAKE
        for now_ms in range(300, 700):
            cell.tick()
            cell.poll(now_ms)
        assert board.registers[speed_loop.MODE] == speed_loop.OFF


def test_lost_heartbeat_cuts_the_motors_at_once_where_settings_say_so():
    cell, board = watching()
    for index in (0x605E, 0x685E):
        cell.on_frame(0x605, sdo.write_request(index, 0, b"\0\0"), cell.now_ms)
    cell.on_frame(0x77F, b"\x05", cell.now_ms)
    for now_ms in range(51, 300):
        cell.poll(now_ms)
    assert board.registers[speed_loop.MODE] == speed_loop.OFF


def test_commands_do_not_end_the_braking_but_a_reset_does():
    for command, mode in (
        (nmt.STOP, speed_loop.BRAKE),
        (nmt.START, speed_loop.BRAKE),
        (nmt.RESET_COMMUNICATION, speed_loop.OFF),
        (nmt.RESET_NODE, speed_loop.OFF),
    ):
        cell, board = watching()
        cell.on_frame(0x77F, b"\x05", cell.now_ms)
        for now_ms in range(51, 300):
            cell.poll(now_ms)
        cell.on_frame(0x000, bytes((command, 5)), cell.now_ms)
        assert board.registers[speed_loop.MODE] == mode
        cell.on_frame(0x305, bytes(4), cell.now_ms)
        assert board.registers[speed_loop.MODE] == mode


def test_error_code_tells_a_stop_while_the_host_is_silent_from_its_silence():
    """A stop is for this node alone, `stop_ms` after the host's last heartbeat; then the bus fails.

    The bus does so while the wheel of a later stop brakes still.
    """
    for stop_ms, bus_off_ms, code in (
        (100, None, 0),
        (100, 150, 0),
        (250, None, 0x9000),
        (250, 260, 0x9000),
        (None, None, 0x8130),
        (None, 150, 0x8140),
    ):
        cell, board = watching()
        cell.on_frame(0x77F, b"\x05", cell.now_ms)
        for now_ms in range(51, 400):
            cell.on_frame(0x205, bytes(8), cell.now_ms)
            cell.on_frame(0x080, b"", cell.now_ms)
            cell.tick()
            cell.poll(now_ms)
            if now_ms - 50 == stop_ms:
                cell.on_frame(0x000, b"\x80\x05", cell.now_ms)
            if now_ms - 50 == bus_off_ms:
                cell.fail(BUS_OFF)
                assert board.registers[speed_loop.MODE] == speed_loop.OFF
        board.take()
        cell.on_frame(0x605, sdo.read_request(0x603F, 0), cell.now_ms)
        answer = b"\x4b\x3f\x60\x00" + code.to_bytes(2, "little") + b"\0\0"
        assert board.take() == [(0x585, answer)]


def awaiting():
    """A cell that has had its target at 50 ms, and awaits the next within 25 ms."""
    cell, board = operational()
    cell.on_frame(0x605, sdo.write_request(0x1400, 5, b"\x19\0"), cell.now_ms)
    cell.on_frame(0x205, bytes(8), cell.now_ms)
    return cell, board


def test_frame_that_does_not_come_in_time_is_reported_once():
    cell, board = awaiting()
    told = []
    for now_ms in range(51, 200):
        cell.poll(now_ms)
        told += [(now_ms, data) for data in emergencies(board)]
    assert told == [(75, b"\x50\x82\x11\x04\0\0\0\0")]
    assert cell.wake_ms == 250  # its heartbeat is due next


def test_frame_that_comes_after_all_takes_the_report_back_and_is_waited_for_again():
    cell, board = awaiting()
    told = []
    for now_ms in range(51, 200):
        if now_ms == 101:
            cell.on_frame(0x205, bytes(8), cell.now_ms)
        cell.poll(now_ms)
        told += [(now_ms, data[:4]) for data in emergencies(board)]
    late, over = b"\x50\x82\x11\x04", b"\x00\x00\x00\x04"
    assert told == [(75, late), (101, over), (125, late)]


def test_rival_that_comes_later_switches_the_motors_off():
    cell, board = operational()
    enable(cell)
    cell.on_frame(0x705, b"\x00", cell.now_ms)
    cell.tick()
    assert board.registers[speed_loop.MODE] == speed_loop.OFF
    assert cell.state == nmt.PRE_OPERATIONAL
    cell.poll(55)
    assert board.take()[0] == (0x085, b"\x50\x81\x11\x05\0\0\0\0")


def test_error_behaviour_is_followed_in_pre_operational_but_leaves_stopped_alone():
    for before, behaviour, after in (
        (nmt.PRE_OPERATIONAL, 0, nmt.PRE_OPERATIONAL),
        (nmt.PRE_OPERATIONAL, 1, nmt.PRE_OPERATIONAL),
        (nmt.PRE_OPERATIONAL, 2, nmt.STOPPED),
        (nmt.STOPPED, 0, nmt.STOPPED),
    ):
        cell, _ = watching()
        cell.on_frame(0x605, sdo.write_request(0x1029, 1, bytes((behaviour,))), cell.now_ms)
        command = nmt.STOP if before == nmt.STOPPED else nmt.ENTER_PRE_OPERATIONAL
        cell.on_frame(0x000, bytes((command, 0)), cell.now_ms)
        assert cell.state == before
        cell.on_frame(0x77F, b"\x05", cell.now_ms)
        for now_ms in range(51, 300):
            cell.poll(now_ms)
        assert cell.state == after


TOO_SHORT = b"\x10\x82\x11\x07\0\0\0\0"
SHORT_NO_MORE = b"\x00\x00\x00\x07\0\0\0\0"


def test_frame_too_short_for_its_pdo_is_reported_once_an_episode():
    cell, board = operational()
    told = []
    for now_ms, length in ((51, 8), (52, 7), (53, 0), (54, 8), (55, 8), (56, 4), (57, 8)):
        cell.on_frame(0x205, bytes(length), cell.now_ms)
        cell.poll(now_ms)
        told += [(now_ms, data) for data in emergencies(board)]
    assert told == [(52, TOO_SHORT), (54, SHORT_NO_MORE), (56, TOO_SHORT), (57, SHORT_NO_MORE)]


def test_frame_too_short_is_reported_even_if_the_next_follows_before_a_poll():
    cell, board = operational()
    cell.on_frame(0x205, bytes(7), cell.now_ms)
    cell.on_frame(0x205, bytes(8), cell.now_ms)
    cell.poll(51)
    assert emergencies(board) == [TOO_SHORT, SHORT_NO_MORE]


def test_frame_too_short_is_not_reported_before_operational():
    cell, board = operational()
    cell.on_frame(0x000, b"\x80\x05", cell.now_ms)
    cell.on_frame(0x205, bytes(7), cell.now_ms)
    cell.poll(51)
    assert emergencies(board) == []


def test_timer_of_an_rpdo_that_is_written_waits_for_the_next_frame():
    cell, board = operational()

    def write_timer(time_ms):
        data = sdo.write_request(0x1400, 5, time_ms.to_bytes(2, "little"))
        cell.on_frame(0x605, data, cell.now_ms)
        board.take()

    def missed_within(wait_ms):
        for _ in range(wait_ms):
            cell.poll(cell.now_ms + 1)
        return [data[:2] for data in emergencies(board)]

    write_timer(100)
    cell.on_frame(0x205, bytes(8), cell.now_ms)
    write_timer(0)
    assert missed_within(1000) == []
    write_timer(100)
    assert missed_within(200) == []
    cell.on_frame(0x205, bytes(8), cell.now_ms)
    assert missed_within(200) == [b"\x50\x82"]
