"""A python-can bus as the sans-IO objects need it: frames in and out, whatever the adapter does.

python-can's own readers end at the first line of garbage from a serial adapter. Here a reader goes
on, records what happened, and ends only when the device itself is gone.
"""

from argparse import ArgumentError, Namespace
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Thread
from types import TracebackType

import can
from can.cli import create_bus_from_namespace

from mdms_host.can_link.drivers import remedy
from mdms_host.clock import Clock
from mdms_model.participant import Participant
from mdms_protocol.frame import Frame

_DEVICE_ERRORS = (can.CanOperationError, OSError)
#: What python-can and its plug-ins raise where a bus cannot be opened; some fail of a library that
#: is not there, or of a channel's kind.
_NO_BUS = (ArgumentError, can.CanError, OSError, ValueError, ImportError, NameError, TypeError)
#: A device that fails this many times in a row, so far apart, is taken to be gone.
_DEVICE_ATTEMPTS = 5
_ATTEMPT_PAUSE_S = 0.05
#: How often a reader checks whether it is to end, and how long a frame may take to leave.
_READ_TIMEOUT_S = 0.1
_SEND_TIMEOUT_S = 0.2


def _is_of_device(error: Exception) -> bool:
    """Whether the device failed; python-can also calls it so when a line cannot be decoded."""
    return isinstance(error, _DEVICE_ERRORS) and not isinstance(error.__cause__, ValueError)


class LinkError(Exception):
    """There is no way to the bus."""


class NoBusError(LinkError):
    """The bus cannot be opened."""


class DeviceGoneError(LinkError):
    """The bus was open, and its device is gone."""


def open_bus(options: Namespace) -> can.BusABC:
    """The bus that python-can's own options, environment and files name.

    Raises NoBusError with what is wrong and what would help.
    """
    try:
        return create_bus_from_namespace(options)
    except _NO_BUS as error:
        interface = getattr(options, "interface", None)
        problem = str(error.__cause__ or error).rstrip(".")
        advice = "name one with -i and -c, or start a virtual one: mdms serve array18"
        if interface is None and "None" in str(error.__cause__):
            reason = "no CAN interface was named"
        else:
            reason = f"the CAN bus cannot be opened: {problem}"
        raise NoBusError(f"{reason}; {remedy(interface, problem) or advice}") from None


class Link:
    """An open bus with a reader of its own; frames of 11-bit data only, the rest is counted.

    Frames go to `deliver(frame, now_s)` in the reader's thread, if given, else wait for `receive`.
    `incidents` lists what the reader met, as (time [s], text); `garbled`, `error_frames` and
    `unsent` count frames.
    """

    def __init__(
        self,
        bus: can.BusABC,
        clock: Clock,
        deliver: Callable[[Frame, float], object] | None = None,
    ) -> None:
        self.incidents: list[tuple[float, str]] = []
        self.garbled = 0
        self.error_frames = 0
        self.unsent = 0
        self._bus = bus
        self._clock = clock
        self._arrived: SimpleQueue[tuple[Frame, float]] = SimpleQueue()
        self._deliver = deliver or (lambda *item: self._arrived.put(item))
        self._gone: str | None = None
        self._closing = False
        self._failures = 0
        self._send_failures = 0
        self._reader = self._start_reader()

    def __enter__(self) -> "Link":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def send(self, frame: Frame) -> None:
        """Send a frame; one that the device cannot take is counted. Raises DeviceGoneError."""
        self.check()
        message = can.Message(
            arbitration_id=frame.can_id, data=frame.data, is_extended_id=False, check=True
        )
        try:
            self._bus.send(message, timeout=_SEND_TIMEOUT_S)
            self._send_failures = 0
        except _DEVICE_ERRORS as error:
            self.unsent += 1
            self._send_failures += 1
            if self._send_failures == _DEVICE_ATTEMPTS:
                self._give_up(error)

    def receive(self, timeout_s: float, handle: Callable[[Frame, float], object]) -> None:
        """Hand over what has arrived; wait for the first frame at most so long.

        Raises DeviceGoneError.
        """
        self.check()
        try:
            handle(*self._arrived.get(timeout=max(0.0, min(timeout_s, _READ_TIMEOUT_S))))
        except Empty:
            return
        # Only what is here by now, so that a full bus cannot keep the caller from its own work.
        for _ in range(self._arrived.qsize()):
            handle(*self._arrived.get())

    def check(self) -> None:
        """Start a reader that has died anew. Raises DeviceGoneError when there is no device."""
        if self._gone:
            raise DeviceGoneError(self._gone)
        if not self._reader.is_alive() and not self._closing:
            self._reader = self._start_reader()

    def close(self) -> None:
        """End the reader and close the bus; a device that is gone is no error."""
        self._closing = True
        self._reader.join(timeout=5.0)
        try:
            self._bus.shutdown()
        except _DEVICE_ERRORS as error:
            self._note(f"the device could not be closed: {error}")

    def _start_reader(self) -> Thread:
        reader = Thread(target=self._read, name="CAN reader", daemon=True)
        reader.start()
        return reader

    def _read(self) -> None:
        """The reader's thread: ends when the link is closed, the device gone, or after garbage."""
        while not self._closing and not self._gone:
            try:
                message = self._bus.recv(_READ_TIMEOUT_S)
            except Exception as error:
                if not _is_of_device(error):
                    self._on_garbage(error)
                    return
                self._on_device_error(error)
            else:
                self._failures = 0
                self._sort(message)

    def _sort(self, message: can.Message | None) -> None:
        if message is None:
            return
        if message.is_error_frame:
            self.error_frames += 1
        elif not message.is_rx:
            # Some drivers (gs_usb) return what was sent.
            return
        elif message.is_extended_id or message.is_remote_frame or message.is_fd:
            self.garbled += 1
        else:
            self._deliver(Frame(message.arbitration_id, bytes(message.data)), self._clock.now_s())

    def _on_device_error(self, error: Exception) -> None:
        self._failures += 1
        self._note(f"the device cannot be read: {error}")
        if self._failures == _DEVICE_ATTEMPTS:
            self._give_up(error)
        self._clock.sleep(_ATTEMPT_PAUSE_S)

    def _on_garbage(self, error: Exception) -> None:
        self.garbled += 1
        self._note(f"the reader died of garbage and is started anew: {error!r}")
        # python-can's slcan keeps undecodable bytes in its buffer and would die of them again.
        flush = getattr(self._bus, "flush", None)
        if flush is not None and isinstance(error.__cause__ or error, UnicodeError):
            with suppress(*_DEVICE_ERRORS):
                flush()

    def _give_up(self, error: Exception) -> None:
        if not self._closing:
            self._gone = f"the CAN device is gone: {error}"

    def _note(self, text: str) -> None:
        if not self._closing:
            self.incidents.append((self._clock.now_s(), text))


def drive(participant: Participant, link: Link, clock: Clock, over: Callable[[], bool]) -> None:
    """Bring participant and bus together until it is over. Raises DeviceGoneError.

    `over` is called after each round, at least ten times a second.
    """
    while not over():
        now_s = clock.now_s()
        if participant.wake_s <= now_s:
            for frame in participant.poll(now_s):
                link.send(frame)
        link.receive(participant.wake_s - clock.now_s(), participant.on_frame)
