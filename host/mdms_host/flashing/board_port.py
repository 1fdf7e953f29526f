"""Serial ports behind which there may be a board with MicroPython."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

#: USB ids of MicroPython's own ports (PYBv1.1), and of the ST-LINK that a Nucleo board has.
_MICROPYTHON = 0xF055
_ST = 0x0483
_ST_LINKS = {0x374B, 0x374E, 0x374F, 0x3752, 0x3753, 0x3754}
_BY_SERIAL = "id:"


class Port(Protocol):
    """A serial port as pyserial lists it."""

    device: str
    vid: int | None
    pid: int | None
    serial_number: str | None
    product: str | None


@dataclass(frozen=True, slots=True)
class BoardPort:
    """A serial port, and what USB reports of it."""

    device: str
    usb_serial: str | None = None
    product: str | None = None


class NoPortError(Exception):
    """A port that was named is not there."""


def list_ports() -> list[Port]:
    """All serial ports of this machine."""
    from serial.tools.list_ports import comports

    return list(comports())


def board_ports(ports: Iterable[Port]) -> list[BoardPort]:
    """Those with the USB ids of boards that there is firmware for, by their names."""
    return sorted((_of(port) for port in ports if _may_be_board(port)), key=lambda one: one.device)


def named_port(name: str, ports: Iterable[Port]) -> BoardPort:
    """The port of a device name, or `id:` and a USB serial number, as mpremote has it.

    A device that is not listed, such as a pseudo-terminal, is taken by its name. Raises
    NoPortError.
    """
    for port in ports:
        if name in (port.device, f"{_BY_SERIAL}{port.serial_number}"):
            return _of(port)
    if name.startswith(_BY_SERIAL):
        raise NoPortError(f"no board has the USB serial number {name.removeprefix(_BY_SERIAL)}")
    return BoardPort(name)


def _of(port: Port) -> BoardPort:
    return BoardPort(port.device, port.serial_number, port.product)


def _may_be_board(port: Port) -> bool:
    return port.vid == _MICROPYTHON or (port.vid == _ST and port.pid in _ST_LINKS)
