"""Firmware into many cells at once: bundles to all, then one cell ahead of the others.

While one cell writes its flash the bus carries the blocks of the others, so that it is never idle.
The first cell that has its bundle starts it alone; only when it has confirmed it do the others.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from math import floor

from mdms_host.flashing.cell_update import CellUpdate
from mdms_model.buses import worst_bits
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame

_FRAME_BITS = worst_bits(8)
#: At most so many frames at once: an adapter's queue takes them, or has room soon.
_BURST = 16
#: Frames of one cell before it is another's turn.
_SHARE = 4


class Updater:
    """A `Participant` that brings each of `updates` to its end, at the pace of the bus.

    `frames` and `bits` count the traffic meanwhile, each frame as long as it can get.
    """

    def __init__(self, updates: Sequence[CellUpdate], bitrate: int) -> None:
        self.updates = list(updates)
        self.frames = 0
        self.bits = 0
        self.began_s: float | None = None
        self.ended_s = 0.0
        self._frame_s = _FRAME_BITS / bitrate
        self._free_s = 0.0
        self._turn = 0
        bundles = {id(update.bundle): update.bundle for update in updates}
        self._together = [
            [update for update in updates if update.bundle is each] for each in bundles.values()
        ]
        self._by_id: dict[int, CellUpdate] = {}
        for update in updates:
            for base in (cob.SDO_RESPONSE_BASE, cob.HEARTBEAT_BASE):
                self._by_id[base + update.node_id] = update

    @property
    def over(self) -> bool:
        """Whether all have come to their ends."""
        return all(update.over for update in self.updates)

    @property
    def wake_s(self) -> float:
        """When to poll next, if nothing comes before [s]."""
        wanted_s = min((update.wake_s for update in self.updates), default=float("inf"))
        return max(wanted_s, self._free_s)

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """A frame was on the bus."""
        self._count(frame)
        update = self._by_id.get(frame.can_id)
        if update is not None:
            update.on_frame(frame)

    def poll(self, now_s: float) -> Iterable[Frame]:
        """As many frames as the bus takes until the next poll."""
        if self.began_s is None:
            self.began_s = self._free_s = now_s
        room = min(floor((now_s - self._free_s) / self._frame_s) + 1, _BURST)
        frames = list(islice(self._wanted(now_s), max(room, 0)))
        for frame in frames:
            self._count(frame)
        self._let_start()
        # Unused time is not saved up: a burst would wait in the adapter.
        self._free_s = max(self._free_s, now_s - _BURST * self._frame_s)
        self._free_s += len(frames) * self._frame_s
        self.ended_s = now_s
        return frames

    def load(self, bitrate: int) -> float:
        """The share of the bus that was taken from begin to end, at most."""
        lasted_s = self.ended_s - (self.began_s or 0.0)
        return min(self.bits / bitrate / lasted_s, 1.0) if lasted_s > 0 else 0.0

    def _let_start(self) -> None:
        """Of the cells of a bundle the first that is loaded goes ahead; the others follow it."""
        for together in self._together:
            begun = [each for each in together if each.may_start]
            if any(each.finished for each in begun):
                _start(each for each in together if each.loaded)
            elif not begun:
                _start([each for each in together if each.loaded and not each.over][:1])
            elif begun[0].failure:
                for each in together:
                    each.give_up(f"node {begun[0].node_id}, which went ahead, has failed")

    def _wanted(self, now_s: float) -> Iterator[Frame]:
        """Frames of the cells in turns; frames that nobody asked for stay with their cell."""
        idle = 0
        while idle < len(self.updates):
            self._turn = (self._turn + 1) % len(self.updates)
            idle += 1
            for frame in islice(self.updates[self._turn].poll(now_s), _SHARE):
                idle = 0
                yield frame

    def _count(self, frame: Frame) -> None:
        self.frames += 1
        self.bits += worst_bits(len(frame.data))


def _start(updates: Iterable[CellUpdate]) -> None:
    for each in updates:
        each.start()
