"""The prompt of a board is reached however the board is starting meanwhile; time is the test's."""

from dataclasses import dataclass

import pytest
from tests.host.flashing.starting_board import StartingBoard, TestClock

from mdms_host.flashing.board_link import (
    BoardLink,
    BoardPort,
    NoBoardError,
    NoPortError,
    board_ports,
    list_ports,
    named_port,
)

serial = pytest.importorskip("serial", reason="pyserial is not installed")
pytest.importorskip("mpremote", reason="mpremote is not installed")

PATIENCE_S = 20.0
ASK_S = 2.0
LATE_S = 0.1


@pytest.fixture
def clock():
    return TestClock()


@pytest.fixture
def plug_in(monkeypatch, clock):
    """Has a board be at the other end of all ports."""

    def plug_in(**times):
        board = StartingBoard(clock, **times)
        monkeypatch.setattr(serial, "serial_for_url", lambda *_, **__: board)
        return board

    return plug_in


def answers(clock):
    with BoardLink("port", clock) as link:
        return [link.ask(f"{number} + 1") for number in range(3)] == [1, 2, 3]


def test_running_cell_is_interrupted_once(plug_in, clock):
    board = plug_in()
    assert answers(clock)
    assert len(board.interrupts_s) == 1
    assert clock.now_s() < LATE_S


def test_board_that_is_being_reset_loses_the_request_and_is_asked_again(plug_in, clock):
    board = plug_in(on_s=0.5, main_s=1.0)
    assert answers(clock)
    assert board.interrupts_s == [pytest.approx(ASK_S, abs=LATE_S)]


def test_request_before_main_runs_ends_nothing_and_is_answered_late(plug_in, clock):
    board = plug_in(main_s=1.0)
    assert answers(clock)
    assert board.interrupts_s == [pytest.approx(ASK_S, abs=LATE_S)]


@pytest.mark.parametrize("start_s", [0.1, 3.0, 5.9, 11.0, 18.0])
def test_board_may_start_as_slowly_as_it_likes(plug_in, clock, start_s):
    board = plug_in(on_s=start_s / 2, main_s=start_s)
    assert answers(clock)
    assert start_s <= board.interrupts_s[0] < start_s + ASK_S + LATE_S


def test_farewell_of_the_firmware_is_not_cut_short(plug_in, clock):
    board = plug_in(farewell_s=1.9)
    assert answers(clock)
    assert len(board.interrupts_s) == 1


def test_watchdog_that_is_faster_than_the_host_delays_it(plug_in, clock):
    board = plug_in(main_s=0.5, bites=2)
    assert answers(clock)
    assert len(board.interrupts_s) == 3


def test_port_that_is_away_while_its_board_is_reset_is_waited_for(plug_in, clock):
    board = plug_in(on_s=3.0, main_s=3.5, there_s=3.0)
    assert answers(clock)
    assert len(board.interrupts_s) == 1


def test_port_that_does_not_come_is_reported(plug_in, clock):
    plug_in(there_s=60.0)
    with pytest.raises(NoBoardError, match="cannot be opened"):
        BoardLink("port", clock)
    assert clock.now_s() < PATIENCE_S


@pytest.mark.parametrize(
    ("times", "said"), [({"on_s": 60.0}, "says nothing"), ({"says": b"speed 0\r\n"}, "speed 0")]
)
def test_patience_ends(plug_in, clock, times, said):
    plug_in(**times)
    with pytest.raises(NoBoardError, match=said):
        BoardLink("port", clock)
    assert PATIENCE_S < clock.now_s() < PATIENCE_S + 2 * ASK_S


@dataclass
class Port:
    device: str
    vid: int | None = None
    pid: int | None = None
    serial_number: str | None = None
    product: str | None = None


PYBOARD = Port("/dev/ttyACM1", 0xF055, 0x9800, "207E347D", "Pyboard Virtual Comm Port")
NUCLEO = Port("/dev/ttyACM0", 0x0483, 0x374E, "0021", "STLINK-V3")
OTHERS = [
    Port("/dev/ttyS0"),
    Port("/dev/ttyACM2", 0x0483, 0x5740, "ST's own serial port", "CAN adapter"),
    Port("/dev/ttyUSB0", 0x1A86, 0x7523, None, "CH340"),
]


def test_boards_are_known_by_their_usb_ids_and_adapters_are_left_alone():
    assert [port.device for port in board_ports([PYBOARD, *OTHERS, NUCLEO])] == [
        "/dev/ttyACM0",
        "/dev/ttyACM1",
    ]


def test_board_goes_by_its_device_or_its_usb_serial_number():
    board = BoardPort("/dev/ttyACM1", "207E347D", "Pyboard Virtual Comm Port")
    assert named_port("/dev/ttyACM1", [NUCLEO, PYBOARD]) == board
    assert named_port("id:207E347D", [NUCLEO, PYBOARD]) == board


def test_device_that_is_not_listed_is_taken_by_its_name():
    assert named_port("/dev/pts/7", [NUCLEO]) == BoardPort("/dev/pts/7")


def test_usb_serial_number_that_is_not_there_is_told():
    with pytest.raises(NoPortError, match="no board has the USB serial number 11"):
        named_port("id:11", [NUCLEO])


def test_this_machine_can_be_asked():
    assert all(port.device for port in list_ports())
