"""The last minute of a table in memory: frames with their senders, beliefs, events, load.

Frames are packed into a ring of bytes: objects would take ten times the memory, and the garbage
collector would walk them. Nothing here grows: new frames overwrite the oldest.
"""

import struct
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mdms_host.clock import load_average, memory_bytes, process_s
from mdms_model.arrays import Floats
from mdms_protocol.codecs.frame import Frame

#: How much of the past is kept [s].
KEPT_S = 60.0
#: A full bus of 1 Mbit/s carries some 8,000 frames a second; a run of 18 cells sends 5,000.
FRAMES_PER_S = 5000
#: Beliefs are kept so often [s].
BELIEF_S = 0.05
_LOAD_S = 1.0
_MOST_EVENTS = 5000
_DATA_MAX = 8
#: Time [s], identifier, length with the flag of own frames, bus, data.
_PACKED = struct.Struct("<dIBB8s")
_SENT = 0x80


@dataclass(frozen=True, slots=True)
class RecentFrame:
    """A frame of the last minute; `sent` is whether this host has sent it."""

    time_s: float
    bus: int
    sent: bool
    frame: Frame


class FrameRing:
    """The last `capacity` frames, packed in a memory that never grows."""

    def __init__(self, capacity: int) -> None:
        self._bytes = bytearray(capacity * _PACKED.size)
        self._size = len(self._bytes)
        self._at = 0
        self._wrapped = False

    def add(self, frame: Frame, now_s: float, bus: int, sent: int) -> None:
        """Keep a frame in place of the oldest; `sent` is 0x80 for one of this host, else 0."""
        can_id, data = frame
        at = self._at
        _PACKED.pack_into(self._bytes, at, now_s, can_id, len(data) | sent, bus, data)
        at += _PACKED.size
        if at == self._size:
            at, self._wrapped = 0, True
        self._at = at

    def packed(self) -> bytes:
        """All frames in their order, as `unpacked` takes them."""
        newer = bytes(memoryview(self._bytes)[: self._at])
        return bytes(memoryview(self._bytes)[self._at :]) + newer if self._wrapped else newer


def unpacked(packed: bytes, from_s: float = 0.0) -> Iterator[RecentFrame]:
    """The frames of a ring from a time on [s]."""
    for time_s, can_id, length, bus, data in _PACKED.iter_unpack(packed):
        if time_s >= from_s:
            size = min(length & ~_SENT, _DATA_MAX)
            yield RecentFrame(time_s, bus, bool(length & _SENT), Frame(can_id, data[:size]))


@dataclass(frozen=True, slots=True)
class Moment:
    """A copy of the last minute that another thread or process may take its time over.

    `frames` are packed. `beliefs` are times [s] with poses (P, 3), `truths` those of a simulated
    table, `events` times with kind and text. `load` has rows of time [s], load average, share of a
    processor that this process took, and the latest cycle in that second [s]. `memory_bytes` is the
    most that the process has had.
    """

    now_s: float
    frames: bytes
    beliefs: list[tuple[float, Floats]]
    truths: list[tuple[float, Floats]]
    events: list[tuple[float, str, str]]
    load: list[tuple[float, float, float, float]]
    memory_bytes: int


class Recent:
    """Keeps the last minute of a table with so many buses; its methods cost no more than they must.

    One thread calls it.
    """

    def __init__(self, buses: int = 1) -> None:
        self._frames = FrameRing(round(KEPT_S * FRAMES_PER_S) * buses)
        most = round(KEPT_S / BELIEF_S)
        self._beliefs: deque[tuple[float, Floats]] = deque(maxlen=most)
        self._truths: deque[tuple[float, Floats]] = deque(maxlen=most)
        self._events: deque[tuple[float, str, str]] = deque(maxlen=_MOST_EVENTS)
        self._load: deque[tuple[float, float, float, float]] = deque(maxlen=round(KEPT_S / _LOAD_S))
        self._belief_due_s = self._truth_due_s = -np.inf
        self._loaded: tuple[float, float] | None = None
        self._late_s = 0.0

    def on_received(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """A frame of somebody else was on a bus."""
        self._frames.add(frame, now_s, bus, 0)

    def on_sent(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """This host has sent a frame."""
        self._frames.add(frame, now_s, bus, _SENT)

    def on_cycle(self, late_s: float) -> None:
        """A cycle was so late [s]."""
        self._late_s = max(self._late_s, late_s)

    def note(self, time_s: float, kind: str, text: str) -> None:
        """Something has happened: an event, an order, a state, an error of the adapter."""
        self._events.append((time_s, kind, text))

    def wants_belief(self, now_s: float) -> bool:
        """Whether the next belief is due."""
        return now_s >= self._belief_due_s

    def believe(self, now_s: float, poses: Floats) -> None:
        """The parcels are believed to be there, shape (P, 3), NaN where unknown."""
        self._belief_due_s = now_s + BELIEF_S
        self._beliefs.append((now_s, poses))
        self._look_at_load(now_s)

    def wants_truth(self, now_s: float) -> bool:
        """Whether the next poses of a simulated table are due."""
        return now_s >= self._truth_due_s

    def see(self, now_s: float, poses: Floats) -> None:
        """The parcels of a simulated table are there, shape (P, 3), NaN for those that are away."""
        self._truth_due_s = now_s + BELIEF_S
        self._truths.append((now_s, poses))
        self._look_at_load(now_s)

    def _look_at_load(self, now_s: float) -> None:
        before = self._loaded
        if before is not None and now_s - before[0] < _LOAD_S:
            return
        self._loaded = now_s, process_s()
        if before is not None:
            share = (self._loaded[1] - before[1]) / (now_s - before[0])
            self._load.append((now_s, load_average(), share, self._late_s))
            self._late_s = 0.0

    def moment(self, now_s: float) -> Moment:
        """A copy of everything that is kept."""
        return Moment(
            now_s,
            self._frames.packed(),
            list(self._beliefs),
            list(self._truths),
            list(self._events),
            list(self._load),
            memory_bytes(),
        )
