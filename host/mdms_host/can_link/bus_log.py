"""The bus log of a run: written, read again, by sender, sent once more, in forms of other tools."""

import io
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from math import inf, isfinite
from pathlib import Path
from typing import Any, Protocol

import can

from mdms_model.errors import InputError
from mdms_model.run.folder import START_S, interface_of
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame

#: Identifiers of the host alone: to all, to each node, and its heartbeat.
_TO_ALL = (cob.NMT, cob.SYNC, cob.LSS_REQUEST, cob.HEARTBEAT_BASE + cob.NODE_MAX)
_TO_NODES = (*cob.RPDO_BASES, cob.SDO_REQUEST_BASE)
_DATA_MAX = 8


def read_log(path: Path) -> Iterator[tuple[float, Frame]]:
    """Times since the run's start [s] and frames of its log. Raises `InputError`.

    A log of several buses is refused, for its frames go back to one.
    """
    only = None
    for time_s, frame, interface in read_buses(path):
        only = only or interface
        if interface != only:
            raise InputError(
                f"{path}: a log of several buses ({only}, {interface}), which cannot be replayed "
                "to one"
            )
        yield time_s, frame


def read_buses(path: Path) -> Iterator[tuple[float, Frame, str]]:
    """Times since the run's start [s], frames and interfaces of a log. Raises `InputError`.

    Frames of 11-bit data alone count.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such bus log; runs of the firmware have one")
    with _Numbered(path.open("rb"), "utf-8-sig", "replace") as file:
        try:
            for message in can.CanutilsLogReader(file):
                other = message.is_remote_frame or message.is_error_frame or message.is_fd
                if not (message.is_extended_id or other):
                    yield _read(message)
        except (ValueError, IndexError) as error:
            raise InputError(f"{path}: not a candump log: {error} (line {file.number})") from None


class _Numbered(io.TextIOWrapper):
    """A text; `number` is that of the line that was read last, from 1."""

    number = 0

    def __next__(self) -> str:  # type: ignore[override]
        self.number += 1
        line = super().__next__()
        if not line.endswith("\n"):
            # A part of a frame would be sent as a whole one.
            raise ValueError("the last line is cut off; remove it")
        return line


def _read(message: can.Message) -> tuple[float, Frame, str]:
    """Raises ValueError for a message that no bus has carried."""
    time_s = message.timestamp
    if not isfinite(time_s):
        raise ValueError(f"a time is {time_s}")
    frame = Frame(message.arbitration_id, bytes(message.data))
    # Half a byte is left of a line that was cut off.
    whole = len(frame.data) == message.dlc <= _DATA_MAX
    if frame.can_id > cob.IDENTIFIER or not whole:
        raise ValueError(f"{frame.can_id:X}#{frame.data.hex().upper()} is no frame of CAN")
    # Logs of older runs begin at 0.
    return time_s - (START_S if time_s >= START_S else 0), frame, str(message.channel)


#: Bytes at the end of a log that surely have a whole line.
_LINE_BYTES = 4096


class _LastingFile(io.FileIO):
    """See `open_log`."""

    def __init__(self, path: Path, failed: Callable[[OSError], object]) -> None:
        super().__init__(path, "w+")
        self._on_failure = failed
        self._has_failed = False

    def write(self, data: Any) -> int:
        """See `io.FileIO`."""
        if self._has_failed:
            return len(data)
        try:
            return super().write(data)
        except OSError as error:
            self._has_failed = True
            self._cut()
            self._on_failure(error)
            return len(data)

    def _cut(self) -> None:
        """End with a whole line."""
        with suppress(OSError):
            start = max(0, self.tell() - _LINE_BYTES)
            self.seek(start)
            self.truncate(start + self.read().rfind(b"\n") + 1)


def open_log(path: Path, failed: Callable[[OSError], object]) -> io.BufferedWriter:
    """Open the bus log of a run that goes on though the disk takes no more: the log ends there.

    `failed(error)` is called then, once. Raises OSError where the file cannot be opened.
    """
    return io.BufferedWriter(_LastingFile(path, failed))


class Writes(Protocol):
    """Anything that takes lines of text."""

    def write(self, text: str, /) -> object:
        """Take a text."""


class LogWriter:
    """Writes frames of 11-bit identifiers as they come, in the form of `candump -L`.

    Frames of both directions come by two clocks' readings; a line is never before the last. With
    several `buses` a line names the frame's. With `directions` it ends with T for a frame of this
    host, else R, as `candump -x` has it. Time 0 is `start_s` [s since 1970].
    """

    def __init__(
        self, file: Writes, buses: int = 1, *, directions: bool = False, start_s: float = START_S
    ) -> None:
        self._file = file
        self._last_s = 0.0
        self._start_s = start_s
        self._directions = (" R", " T") if directions else ("", "")
        self._interfaces = [interface_of(bus, buses) for bus in range(buses)]

    def on_frame(self, frame: Frame, time_s: float, bus: int = 0, *, sent: bool = False) -> None:
        """Append one line."""
        self._last_s = max(self._last_s, time_s)
        data = frame.data.hex().upper()
        time = f"{self._start_s + self._last_s:.6f}"
        direction = self._directions[sent]
        self._file.write(f"({time}) {self._interfaces[bus]} {frame.can_id:03X}#{data}{direction}\n")


def chosen(frames: Iterable[tuple[float, Frame]], sender: str) -> Iterator[tuple[float, Frame]]:
    """The frames that the host, the cells, or all have sent."""
    for time_s, frame in frames:
        if sender == "all" or is_from_host(frame.can_id) == (sender == "host"):
            yield time_s, frame


def is_from_host(can_id: int) -> bool:
    """Whether the host sends this identifier in the predefined connection set (CiA 301, 7.3.3)."""
    return can_id in _TO_ALL or (bool(can_id & 0x7F) and can_id & ~0x7F in _TO_NODES)


class LogPlayer:
    """A participant that sends frames at their times, counted from its start."""

    def __init__(self, frames: list[tuple[float, Frame]], start_s: float) -> None:
        self.start_s = start_s
        self._frames = frames
        self._next = 0

    @property
    def over(self) -> bool:
        """Whether all has been sent."""
        return not self.left

    @property
    def left(self) -> int:
        """How many frames have not been sent yet."""
        return len(self._frames) - self._next

    @property
    def wake_s(self) -> float:
        """When the next frame is due [s]."""
        return inf if self.over else self.start_s + self._frames[self._next][0]

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Frames of others change nothing."""

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The frames that are due."""
        while self.wake_s <= now_s:
            frame = self._frames[self._next][1]
            self._next += 1
            yield frame
