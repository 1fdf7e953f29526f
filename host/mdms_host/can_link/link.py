"""A python-can bus as the sans-IO objects need it: frames in and out, with any adapter.

A full transmit queue is waited for, for a while. Incidents are noted with their times, and counted.
"""

import errno
import os
import socket
from argparse import ArgumentError, Namespace
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from re import search
from threading import Thread
from typing import Any, Protocol, TypeVarTuple

import can
from can.cli import create_bus_from_namespace
from can.interfaces.slcan import slcanBus

from mdms_host.can_link.delays import Delays, first_in_line
from mdms_host.can_link.slcan_port import GarbledError, SlcanPort
from mdms_host.clock import Clock
from mdms_model.errors import Error
from mdms_model.participant import Participant
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame

#: The extra of python-can that brings an interface's driver.
_EXTRAS: Mapping[str, str] = {
    "canalystii": "canalystii",
    "cantact": "cantact",
    "gs_usb": "gs-usb",
    "neovi": "neovi",
    "nixnet": "nixnet",
    "pcan": "pcan",
    "robotell": "serial",
    "seeedstudio": "seeedstudio",
    "serial": "serial",
    "slcan": "serial",
    "udp_multicast": "multicast",
    "usb2can": "pywin32",
}
#: How python-can and its plug-ins report that a module or a library is not there.
_MISSING = (
    "No module named",
    "not installed",
    "Please install",
    "not found",
    "could not be loaded",
)
#: The makers' own libraries, which no package brings.
_LIBRARIES: Mapping[str, str] = {
    "kvaser": "Kvaser's CANlib",
    "pcan": "PEAK's PCANBasic library",
    "vector": "Vector's XL driver library",
}


#: The cures of errors of the system, by interface and number.
_NO_CAN = (
    "this system has no CAN (SocketCAN is Linux's, and the kernel's module is `can`): "
    "sudo modprobe can, or take another interface with -i"
)
_CURES: Mapping[tuple[str, int], str] = {
    ("socketcan", errno.EAFNOSUPPORT): _NO_CAN,
    ("socketcan", errno.EPROTONOSUPPORT): _NO_CAN,
    ("socketcan", errno.ENODEV): (
        "there is no such interface; `ip link show type can` lists those that there are, and "
        "sudo ip link set can0 up type can bitrate 1000000 starts one"
    ),
    ("socketcan", errno.ENETDOWN): (
        "the interface is down: sudo ip link set can0 up type can bitrate 1000000"
    ),
    ("slcan", errno.EACCES): (
        "you may not use this port: sudo usermod -a -G dialout $USER, then log in again"
    ),
    ("slcan", errno.ENOENT): (
        "there is no such port; `python -m serial.tools.list_ports` lists those that there are"
    ),
}


def remedy(interface: str | None, problem: str, number: int | None = None) -> str | None:
    """Advice that makes the interface work, None without any.

    `problem` is the text of the error, and `number` that of the system's error, if it was one.
    """
    if interface is None:
        return None
    if number is not None and (interface, number) in _CURES:
        return _CURES[interface, number]
    if not any(text in problem for text in _MISSING):
        return None
    if interface in _LIBRARIES:
        return f"install {_LIBRARIES[interface]}"
    if interface in _EXTRAS:
        return f"install its driver: pip install 'python-can[{_EXTRAS[interface]}]'"
    return None


#: An incident that repeats is noted as often [s].
_REPEAT_S = 1.0
_KEPT = 1000


class Incidents:
    """`noted` lists incidents as (time [s], text), the first thousand.

    Several may share one list; each then begins its texts with its subject, `about`.
    """

    def __init__(
        self, clock: Clock, noted: list[tuple[float, str]] | None = None, about: str = ""
    ) -> None:
        self.noted = [] if noted is None else noted
        self._about = about
        self._clock = clock
        self._last_s: dict[str, float] = {}

    def note(self, text: str) -> None:
        """Note an incident."""
        if len(self.noted) < _KEPT:
            self.noted.append((self._clock.now_s(), self._about + text))

    def note_repeated(self, kind: str, detail: object = "") -> None:
        """Note an incident that may come with every frame, the first of its kind in a second."""
        now_s = self._clock.now_s()
        if now_s - self._last_s.get(kind, -_REPEAT_S) >= _REPEAT_S:
            self._last_s[kind] = now_s
            self.note(f"{kind}: {detail}" if detail else kind)


@dataclass(frozen=True, slots=True)
class LinkCounts:
    """Frames that were no plain data, and those that the transmit queue delayed or refused.

    `foreign` are whole frames of other devices, of kinds that no cell sends.
    """

    garbled: int = 0
    error_frames: int = 0
    waited: int = 0
    unsent: int = 0
    foreign: int = 0

    def __add__(self, other: "LinkCounts") -> "LinkCounts":
        return LinkCounts(
            self.garbled + other.garbled,
            self.error_frames + other.error_frames,
            self.waited + other.waited,
            self.unsent + other.unsent,
            self.foreign + other.foreign,
        )

    def since(self, before: "LinkCounts") -> "LinkCounts":
        """The counts since then."""
        return LinkCounts(
            self.garbled - before.garbled,
            self.error_frames - before.error_frames,
            self.waited - before.waited,
            self.unsent - before.unsent,
            self.foreign - before.foreign,
        )

    def __str__(self) -> str:
        """The counts above zero, as one line; empty without any."""
        texts = (
            (self.garbled, "garbled"),
            (self.error_frames, "error frames"),
            (self.waited, "waited for the transmit queue"),
            (self.unsent, "not sent"),
            (self.foreign, "with 29 bits, remote or of CAN FD"),
        )
        return ", ".join(f"{count} {text}" for count, text in texts if count)


#: One attempt of an interface that waits by itself; a control cycle has room for several.
_ATTEMPT_S = 0.002
#: A frame of 8 bytes at 250 kbit/s takes as long; so much later there may be room for one.
_PAUSE_S = 0.0005
#: The queue of SocketCAN (10 frames) is full, that of a socket, of a USB adapter.
_FULL = frozenset((errno.ENOBUFS, errno.EAGAIN, errno.ETIMEDOUT))


def is_full(error: BaseException | None) -> bool:
    """Whether a frame could not be sent for want of room only.

    python-can has no class for it: SocketCAN's error has a number or the text 'Transmit buffer
    full', USB adapters' and serial lines' stand behind it as its cause.
    """
    while error is not None:
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if number in _FULL or isinstance(error, TimeoutError):
            return True
        if type(error).__name__ == "SerialTimeoutException":
            return True
        if search(r"\bfull\b", str(error).lower()):
            return True
        error = error.__cause__
    return False


class Transmitter:
    """`waited` counts frames that a full queue has delayed, `unsent` those that never left.

    `full_since_s` is when the queue was found full, None while it is not.
    """

    def __init__(self, port: can.BusABC | SlcanPort, clock: Clock) -> None:
        self.waited = 0
        self.unsent = 0
        self.full_since_s: float | None = None
        self._port = port
        self._clock = clock

    def send(self, message: can.Message, until_s: float) -> bool:
        """Send a frame, or give it up at `until_s`, after one attempt at least.

        Raises the error of the device if it is not for want of room.
        """
        waited = False
        while not self._attempt(message, until_s):
            now_s = self._clock.now_s()
            if self.full_since_s is None:
                self.full_since_s = now_s
            if now_s >= until_s:
                self.unsent += 1
                return False
            waited = True
            self._clock.sleep(_PAUSE_S)
        self.full_since_s = None
        self.waited += waited
        return True

    def _attempt(self, message: can.Message, until_s: float) -> bool:
        # An interface that waits by itself waits no longer than the frame may.
        left_s = max(0.0, until_s - self._clock.now_s())
        try:
            self._port.send(message, timeout=min(_ATTEMPT_S, left_s))
        except (can.CanError, OSError) as error:
            if is_full(error):
                return False
            self.unsent += 1
            raise
        return True


Parts = TypeVarTuple("Parts")

_DEVICE_ERRORS = (can.CanOperationError, OSError)
#: Errors of python-can and its plug-ins for a bus that cannot be opened; some come of a missing
#: library, or of a channel of the wrong kind.
_NO_BUS = (ArgumentError, can.CanError, OSError, ValueError, ImportError, NameError, TypeError)
#: A device that fails this many times in a row, so far apart, is taken to be gone.
_DEVICE_ATTEMPTS = 5
_ATTEMPT_PAUSE_S = 0.05
#: How often a reader checks whether it is to end.
READ_TIMEOUT_S = 0.1
#: How long frames may wait for room in the transmit queue: a cycle, then newer ones are due.
QUEUE_WAIT_S = 0.01
_FULL_HELP = "frames are not sent; does anybody acknowledge them, and is the bit rate right?"


#: Errors that bytes without a meaning lead to: a line of a serial adapter, a stray datagram.
_UNDECODABLE = (ValueError, TypeError, AttributeError, LookupError)


def _is_of_device(error: Exception) -> bool:
    """Whether the device failed; python-can also calls it so when bytes cannot be decoded."""
    return isinstance(error, _DEVICE_ERRORS) and not isinstance(error.__cause__, _UNDECODABLE)


class LinkError(Error):
    """There is no way to the bus."""


class NoBusError(LinkError):
    """The bus cannot be opened."""


class DeviceGoneError(LinkError):
    """The bus was open, and its device is gone."""


def open_bus(options: Namespace) -> can.BusABC:
    """The bus that python-can's own options, environment and files name.

    Raises NoBusError with cause and cure.
    """
    try:
        return create_bus_from_namespace(options)
    except _NO_BUS as error:
        interface = getattr(options, "interface", None)
        problem = str(error.__cause__ or error).rstrip(".")
        number = _errno_of(error)
        cure = remedy(interface, problem, number)
        advice = "name one with -i and -c, or start a virtual one: mdms serve array18"
        channel = getattr(options, "channel", None)
        if interface is None and "None" in str(error.__cause__):
            reason = "no CAN interface was named"
            if channel is not None:
                reason += f" for channel {channel}"
                cure = "name one with -i; -i mdms is that of a table that mdms serve serves"
        elif channel is None and problem.endswith("argument: 'channel'"):
            reason = f"no channel was named for {interface}"
        elif cure is not None and number is not None:
            reason = f"{interface} {channel} cannot be opened: {os.strerror(number)}"
        elif interface in {None, "mdms"} or channel is None:
            reason = f"the CAN bus cannot be opened: {problem}"
        else:
            reason = f"{interface} {channel} cannot be opened: {problem}"
            advice = "look at its plug, its driver and its name"
        # The interface of served arrays says itself what is served.
        told = reason if interface == "mdms" else f"{reason}; {cure or advice}"
        raise NoBusError(told) from None


def _errno_of(error: BaseException | None) -> int | None:
    """The number of the system's error behind what python-can raised."""
    while error is not None:
        if number := getattr(error, "errno", None) or getattr(error, "error_code", None):
            return int(number)
        error = error.__cause__ or error.__context__
    return None


class Link:
    """An open bus with a reader of its own; frames of 11-bit data only, the rest is counted.

    Frames go to `deliver(frame, now_s)` in the reader's thread, if given, else wait for `receive`.
    `garbled`, `error_frames`, `foreign` and `unsent` count frames; `incidents` has what else the
    link met, and may be given where it is shared. `delays` has the parts that were held up lately.
    """

    def __init__(
        self,
        bus: can.BusABC,
        clock: Clock,
        deliver: Callable[[Frame, float], object] | None = None,
        incidents: Incidents | None = None,
    ) -> None:
        self.garbled = 0
        self.error_frames = 0
        self.foreign = 0
        self.delays = Delays()
        self._incidents = incidents or Incidents(clock)
        self._bus = bus
        self._port = _port_of(bus)
        self._own_are_marked = _own_are_marked(bus)
        self._transmitter = Transmitter(self._port, clock)
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

    def __exit__(self, *_error: object) -> None:
        self.close()

    @property
    def incidents(self) -> list[tuple[float, str]]:
        """Incidents so far, as (time [s], text)."""
        return self._incidents.noted

    @property
    def unsent(self) -> int:
        """Frames that did not leave: no room in time, a failing device, an adapter's refusal."""
        refused = self._port.refused if isinstance(self._port, SlcanPort) else 0
        return self._transmitter.unsent + refused

    @property
    def counts(self) -> LinkCounts:
        """All counts at this moment."""
        waited = self._transmitter.waited
        return LinkCounts(self.garbled, self.error_frames, waited, self.unsent, self.foreign)

    def send(self, frame: Frame, until_s: float | None = None) -> None:
        """Send a frame; a frame that the device cannot take is counted. Raises DeviceGoneError.

        A full transmit queue is waited for until `until_s`, for one cycle if that is not given.
        """
        self.check()
        message = can.Message(
            arbitration_id=frame.can_id, data=frame.data, is_extended_id=False, check=True
        )
        if until_s is None:
            until_s = self._clock.now_s() + QUEUE_WAIT_S
        try:
            if not self._transmitter.send(message, until_s):
                self._incidents.note_repeated("the transmit queue stays full", _FULL_HELP)
            self._send_failures = 0
        except _DEVICE_ERRORS as error:
            self._incidents.note_repeated("the device cannot be written", error)
            self._send_failures += 1
            if self._send_failures == _DEVICE_ATTEMPTS:
                self._give_up(error)

    def send_polled(self, participant: Participant, now_s: float) -> None:
        """Send the frames that a participant has to send now. Raises DeviceGoneError."""
        self.send_all(participant.poll(now_s))

    def send_all(self, frames: Iterable[Frame]) -> None:
        """Send the frames of one cycle, which wait for room as long as that together.

        Raises DeviceGoneError.
        """
        until_s = self._clock.now_s() + QUEUE_WAIT_S
        for frame in frames:
            self.send(frame, until_s)

    def receive(self, timeout_s: float, handle: Callable[[Frame, float], object]) -> None:
        """Hand over the received frames; wait for the first frame at most so long.

        Raises DeviceGoneError.
        """
        self.check()
        hand_over(self._arrived, timeout_s, handle)

    def leave_gone(self) -> bool:
        """Whether any bus is left without those whose devices are gone: here, none."""
        return False

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
        reader = Thread(target=self._read_first, name="CAN reader", daemon=True)
        reader.start()
        return reader

    def _read_first(self) -> None:
        with first_in_line():
            self._read()

    def _read(self) -> None:
        """The reader's thread: ends when the link is closed, the device gone, or after garbage."""
        while not self._closing and not self._gone:
            try:
                message = self._port.recv(READ_TIMEOUT_S)
            except GarbledError as error:
                self.garbled += 1
                self._incidents.note_repeated("garbage was received", error)
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
        now_s = self._clock.now_s()
        self.delays.on_arrival(now_s)
        if message.is_error_frame:
            self.error_frames += 1
            self._incidents.note_repeated("there are error frames on the bus")
        elif not message.is_rx and self._own_are_marked:
            # Some drivers (gs_usb) return sent frames.
            return
        elif message.is_extended_id or message.is_remote_frame or message.is_fd:
            self.foreign += 1
            self._incidents.note_repeated("frames that are no data or have 29 bits are left out")
        else:
            node_id = message.arbitration_id - cob.HEARTBEAT_BASE
            if 0 < node_id < cob.HOST_NODE:
                self.delays.on_heartbeat(node_id, now_s)
            self._deliver(Frame(message.arbitration_id, bytes(message.data)), now_s)

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
            self._incidents.note(text)


def _port_of(bus: can.BusABC) -> can.BusABC | SlcanPort:
    """The bus itself, or the serial line behind it where that can be read in larger pieces."""
    if isinstance(bus, slcanBus) and os.name == "posix":
        with suppress(NotImplementedError, can.CanOperationError):
            bus.fileno()
            return SlcanPort(bus)
    return bus


def _own_are_marked(bus: can.BusABC) -> bool:
    """Whether frames that are marked as not received are this link's own.

    SocketCAN marks those of every program of this computer, such as the NMT command of `mdms stop`
    in another terminal; a link's own come back only where that was asked for.
    """
    if type(bus).__name__ != "SocketcanBus":
        return True
    own: int = vars(bus)["socket"].getsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS)
    return bool(own)


def hand_over(
    arrived: SimpleQueue[tuple[*Parts]], timeout_s: float, handle: Callable[[*Parts], object]
) -> None:
    """Pass on the received frames; wait for the first at most so long.

    Only frames that are here by then, so that a full bus cannot keep the caller from its own work.
    """
    try:
        handle(*arrived.get(timeout=max(0.0, min(timeout_s, READ_TIMEOUT_S))))
    except Empty:
        return
    for _ in range(arrived.qsize()):
        handle(*arrived.get())


class AnyDelays(Protocol):
    """The parts of a link, or of several, that were held up."""

    def on_cycle(self, due_s: float, now_s: float) -> None:
        """Something that was due is done now."""

    def on_blocked(self, where: str, took_s: float, now_s: float) -> None:
        """The program that a person wrote has just computed for so long."""

    def reason(self, now_s: float) -> str | None:
        """The parts that were held up in the last second; None if nothing was."""

    def slow_reason(self, now_s: float) -> str | None:
        """The evidence of heartbeats alone, with or without SYNC; None if they come in time."""


class AnyLink(Protocol):
    """A link to one bus, or to several at once, as a run asks for it."""

    @property
    def incidents(self) -> list[tuple[float, str]]:
        """Incidents so far, as (time [s], text)."""

    @property
    def counts(self) -> LinkCounts:
        """All counts at this moment."""

    @property
    def delays(self) -> "AnyDelays":
        """The parts that were held up lately."""

    def send(self, frame: Frame) -> None:
        """Send a frame to all cells."""

    def send_polled(self, participant: Any, now_s: float) -> None:
        """Send the frames that a participant has to send now, each on its bus."""

    def receive(self, timeout_s: float, handle: Any) -> None:
        """Hand over the received frames; wait for the first frame at most so long."""

    def leave_gone(self) -> bool:
        """Go on without buses whose devices are gone; whether any other is left."""


def drive(participant: Any, link: AnyLink, clock: Clock, over: Callable[[], bool]) -> None:
    """Bring participant and bus together until it is over. Raises DeviceGoneError.

    The participant is a `Participant`, or a `BusesParticipant` where the link has several buses.

    `over` is called after each round, at least ten times a second.
    """
    polled_s = clock.now_s()
    while not over():
        now_s, wake_s = clock.now_s(), participant.wake_s
        if wake_s <= now_s:
            # A participant that is due at once may say so by any time in the past.
            link.delays.on_cycle(max(wake_s, polled_s), now_s)
            polled_s = now_s
            link.send_polled(participant, now_s)
        link.receive(participant.wake_s - clock.now_s(), participant.on_frame)
