from dataclasses import dataclass

import pytest

from mdms_host.flashing.board_link import (
    BoardPort,
    NoPortError,
    board_ports,
    list_ports,
    named_port,
)


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
