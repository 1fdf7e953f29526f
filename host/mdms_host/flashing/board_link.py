"""The prompt of a board with MicroPython over a serial port, by mpremote's raw REPL.

Ctrl-C ends the cell's firmware, which cuts the motors. Its watchdog cannot be stopped, so it is
given more patience at once, and is fed from then on; should the host go away, it resets the board.
Ports behind which there may be a board are listed here too.
"""

import re
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Protocol

from mdms_host.clock import Clock
from mdms_host.flashing.firmware import value_of

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


#: The longest that the watchdog of an STM32 takes is 32 s.
WATCHDOG_MS = 30_000
_ASK, _RAW, _RESET = b"\r\x03\r\x01", b"\r\x01", b"\x04"
_PROMPT = b">>> "
_BANNER = b"raw REPL; CTRL-B to exit\r\n"
_REBOOT = b"soft reboot\r\n"
_END = b"\x04"
#: A board that is being reset loses its input, and until `main.py` runs, Ctrl-C ends nothing. So it
#: is asked again, but not sooner: that would cut the farewell of its firmware short.
_ASK_S = 2.0
#: It may be reset meanwhile, by a watchdog that was faster than we were, and start anew.
_PATIENCE_S = 20.0
_ANSWER_S = 5.0
_RUN_S = 10.0
#: Over USB of its own a port is away while its board is reset.
_RETURN_S = 4.0
_LOOK_S = 0.01
#: No program has so much more to say once it is interrupted.
_MUCH_BYTES = 4096
_CHUNK = 1024
_GUARD = f"""\
try:
    import machine
    _feed = machine.WDT(timeout={WATCHDOG_MS}).feed
except (ImportError, AttributeError):
    _feed = lambda: None
_feed()
"""


#: ENOSPC, as MicroPython tells it with and without the names of errors.
_NO_SPACE = re.compile(r"^OSError: (28$|.*ENOSPC)")
_FULL = (
    "its flash is full, and it does not start now; delete files that are not of the firmware "
    "(mpremote fs ls), and flash it again"
)


class BoardError(Exception):
    """A board did not obey; the message has the order, and the way out."""


class NoBoardError(BoardError):
    """Nobody answers as MicroPython does, or does no longer."""


class MpremoteMissingError(Exception):
    """The package mpremote is not installed."""


class BoardLink:
    """A board at its prompt, with no program running; the end of its `with` closes the port.

    Raises NoBoardError, MpremoteMissingError.
    """

    def __init__(self, device: str, clock: Clock) -> None:
        self.device = device
        self._clock = clock
        self._transport: Any = None
        self._holds = 0
        self._connect()

    def __enter__(self) -> "BoardLink":
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def run(self, code: str) -> str:
        """The output of a piece of MicroPython. Raises BoardError, NoBoardError."""
        try:
            printed, failure = self._transport.exec_raw(code, timeout=_RUN_S)
        except _troubles() as error:
            raise NoBoardError(f"the board is gone; flash it again ({error})") from None
        if failure:
            told = failure.decode("utf-8", "replace").strip().splitlines()[-1]
            raise BoardError(f"{told}: {_FULL}" if _NO_SPACE.search(told) else told)
        return str(printed.decode("utf-8", "replace"))

    def ask(self, expression: str) -> Any:
        """The value of an expression of plain types. Raises BoardError, NoBoardError."""
        told = self.run(f"print(repr({expression}))")
        try:
            return value_of(told.strip())
        except (ValueError, SyntaxError):
            raise BoardError(f"cannot make sense of {told.strip()!r}") from None

    def write(self, path: str, data: bytes) -> None:
        """Make a file with this content. Raises BoardError, NoBoardError."""
        self.run(f"_file = open({path!r}, 'wb')")
        for start in range(0, len(data), _CHUNK):
            self.run(f"_file.write({data[start : start + _CHUNK]!r}); _feed()")
        self.run("_file.close()")

    def read(self, path: str) -> bytes:
        """The content of a file. Raises BoardError, NoBoardError."""
        self.run(f"_file = open({path!r}, 'rb')")
        data = b""
        while piece := self.ask(f"(_file.read({_CHUNK}), _feed())[0]"):
            data += piece
        self.run("_file.close()")
        return data

    @contextmanager
    def released(self) -> Iterator[None]:
        """The port is free for another program meanwhile; then the board begins anew, as at first.

        Nobody feeds the watchdog until then. Raises NoBoardError.
        """
        self.run("_feed()")
        self.close()
        try:
            yield
        finally:
            self._connect()

    def restart(self) -> None:
        """Reset the board, which then runs its own program."""
        with suppress(*_troubles()):
            self._transport.exec_raw_no_follow("import machine; machine.reset()")

    def close(self) -> None:
        """Close the port; a board that is gone does not mind."""
        with suppress(*_troubles()):
            self._transport.close()

    def _connect(self) -> None:
        end_s = self._clock.now_s() + _PATIENCE_S
        while True:
            self._transport = self._opened()
            try:
                self._take_over()
                return
            except _troubles() as error:
                self.close()
                if self._clock.now_s() > end_s:
                    raise NoBoardError(f"no MicroPython prompt answers: {error}") from None
            self._clock.sleep(_LOOK_S)

    def _opened(self) -> Any:
        """The port, as soon as it is there: a board is easiest to interrupt while it starts."""
        end_s = self._clock.now_s() + _RETURN_S
        while True:
            try:
                return _open(self.device)
            except NoBoardError:
                if self._clock.now_s() > end_s:
                    raise
            self._clock.sleep(_LOOK_S)

    def _take_over(self) -> None:
        """End what runs, hold the watchdog, and begin anew without `main.py`."""
        self._transport.serial.write(_ASK)
        if self._await(_BANNER, _PROMPT, limit_s=_ASK_S).endswith(_PROMPT):
            # It has come to its prompt by itself, perhaps, and was not there to be asked.
            self._transport.serial.write(_RAW)
            self._await(_BANNER, limit_s=_ASK_S)
        self._hold()
        self._transport.serial.write(_RESET)
        self._await(_REBOOT)
        self._await(_BANNER)
        self._hold()

    def _hold(self) -> None:
        """Give the watchdog patience; answers to earlier questions come then."""
        self._holds += 1
        mark = f"held {self._holds}"
        self._transport.serial.write(f"{_GUARD}print({mark!r})\n".encode() + _RESET)
        printed, failure = self._await(_END), self._await(_END)
        if not printed.removesuffix(_END).rstrip().endswith(mark.encode()):
            raise TimeoutError(_said(printed + failure))

    def _await(self, *endings: bytes, limit_s: float | None = None) -> bytes:
        """The bytes up to one of the endings. Raises TimeoutError."""
        end_s = self._clock.now_s() + (_ANSWER_S if limit_s is None else limit_s)
        told = b""
        while not told.endswith(endings):
            waiting = self._transport.serial.in_waiting
            if self._clock.now_s() > end_s and (not waiting or len(told) > _MUCH_BYTES):
                raise TimeoutError(_said(told))
            if waiting:
                told += self._transport.serial.read(1)
            else:
                self._clock.sleep(_LOOK_S)
        return told


def _said(told: bytes) -> str:
    return f"it says {told[-40:]!r}" if told else "it says nothing"


def _open(device: str) -> Any:
    try:
        from mpremote.transport import TransportError  # type: ignore[import-untyped]
        from mpremote.transport_serial import SerialTransport  # type: ignore[import-untyped]
    except ImportError:
        raise MpremoteMissingError(
            "mpremote is not installed; it comes with pip install 'mdms-array[boards]'"
        ) from None
    try:
        transport = SerialTransport(device, timeout=_ANSWER_S)
    except (TransportError, OSError):
        raise NoBoardError(
            "cannot be opened; is it there, and does no other program use it?"
        ) from None
    transport.serial.write_timeout = _ANSWER_S
    return transport


def _troubles() -> tuple[type[Exception], ...]:
    """The errors of mpremote for a board that does not talk as it should, or is gone."""
    from mpremote.transport import TransportError

    return TransportError, OSError, struct.error
