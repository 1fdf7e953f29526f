"""The prompt of a board with MicroPython over a serial port, by mpremote's raw REPL.

Ctrl-C ends the cell's firmware, which cuts the motors. Its watchdog cannot be stopped, so it is
given more patience at once, and is fed from then on; should the host go away, it resets the board.
"""

import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Any

from mdms_host.clock import Clock
from mdms_host.flashing.parsing import value_of

#: The longest that the watchdog of an STM32 takes is 32 s.
WATCHDOG_MS = 30_000
_INTERRUPT, _RAW, _RESET = b"\r\x03", b"\r\x01", b"\x04"
_BANNER = b"raw REPL; CTRL-B to exit\r\n"
_REBOOT = b"soft reboot\r\n"
_READ_S = 2.0
_PROMPT_S = 5.0
#: A watchdog that was faster than we were resets the board, which then comes back.
_ATTEMPTS = 3
_RETURN_S = 4.0
_LOOK_S = 0.02
_CHUNK = 1024
_GUARD = f"""\
try:
    import machine
    _feed = machine.WDT(timeout={WATCHDOG_MS}).feed
except (ImportError, AttributeError):
    _feed = lambda: None
_feed()
"""


class BoardError(Exception):
    """A board did not do what it was asked; the message says what, and the way out."""


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
        self._connect()

    def __enter__(self) -> "BoardLink":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def run(self, code: str) -> str:
        """What a piece of MicroPython prints. Raises BoardError, NoBoardError."""
        try:
            printed, failure = self._transport.exec_raw(code)
        except _troubles() as error:
            raise NoBoardError(f"the board is gone; flash it again ({error})") from None
        if failure:
            raise BoardError(failure.decode("utf-8", "replace").strip().splitlines()[-1])
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
        """Reset the board, which then runs what lies on it."""
        with suppress(*_troubles()):
            self._transport.exec_raw_no_follow("import machine; machine.reset()")

    def close(self) -> None:
        """Close the port; a board that is gone does not mind."""
        with suppress(*_troubles()):
            self._transport.close()

    def _connect(self) -> None:
        self._transport = _open(self.device)
        for attempt in range(_ATTEMPTS):
            try:
                self._take_over()
                return
            except _troubles() as error:
                self.close()
                if attempt == _ATTEMPTS - 1:
                    raise NoBoardError(f"no MicroPython prompt answers: {error}") from None
            self._transport = self._reopened()

    def _take_over(self) -> None:
        """End what runs, hold the watchdog, and begin anew without `main.py`."""
        # Once only: a second Ctrl-C would cut the firmware's farewell short.
        self._transport.serial.write(_INTERRUPT)
        self._transport.serial.write(_RAW)
        self._await(_BANNER)
        self._exec(_GUARD)
        self._await(b">")
        self._transport.serial.write(_RESET)
        self._await(_REBOOT)
        self._await(_BANNER)
        self._exec(_GUARD)

    def _reopened(self) -> Any:
        """The port, as soon as it is back: a board is easiest to interrupt while it starts."""
        end_s = self._clock.now_s() + _RETURN_S
        while True:
            try:
                return _open(self.device)
            except NoBoardError:
                if self._clock.now_s() > end_s:
                    raise
            self._clock.sleep(_LOOK_S)

    def _await(self, ending: bytes) -> None:
        told = self._transport.read_until(1, ending, timeout=_READ_S, timeout_overall=_PROMPT_S)
        if not told.endswith(ending):
            raise TimeoutError(f"it says {told[-40:]!r}" if told else "it says nothing")

    def _exec(self, code: str) -> None:
        _printed, failure = self._transport.exec_raw(code)
        if failure:
            raise TimeoutError(failure.decode("utf-8", "replace").strip().splitlines()[-1])


def _open(device: str) -> Any:
    try:
        from mpremote.transport import TransportError  # type: ignore[import-untyped]
        from mpremote.transport_serial import SerialTransport  # type: ignore[import-untyped]
    except ImportError:
        raise MpremoteMissingError(
            "mpremote is not installed; it comes with pip install 'mdms-array[boards]'"
        ) from None
    try:
        transport = SerialTransport(device, timeout=_READ_S)
    except (TransportError, OSError):
        raise NoBoardError(
            "cannot be opened; is it there, and does no other program use it?"
        ) from None
    transport.serial.write_timeout = _READ_S
    return transport


def _troubles() -> tuple[type[Exception], ...]:
    """What mpremote raises when a board does not talk as it should, or is gone."""
    from mpremote.transport import TransportError

    return TransportError, OSError, struct.error
