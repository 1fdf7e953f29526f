"""The way of one cell from the firmware that it has to another, as a script of requests."""

from collections.abc import Generator, Iterator
from typing import Protocol

from mdms_host.can_link.sdo_client import Read, SdoClient, Setting
from mdms_host.updating.block_download import BlockDownload
from mdms_host.updating.bundles import Bundle
from mdms_host.updating.reasons import reason_text
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.update import codes

#: Writing the record to flash may take a cell this long.
_FLASH_S = 2.0
#: A reset, MicroPython's start, and the claim of the node id.
_BOOT_S = 20.0
#: A cell on trial runs for a while before it is confirmed, so that it may fail.
_TEST_S = 0.5
#: What a transfer may have met on its way, and may be tried again for.
_PASSING = frozenset(
    (sdo.TIMED_OUT, sdo.CRC_ERROR, sdo.UNKNOWN_COMMAND, sdo.INVALID_SEQUENCE, sdo.WRONG_STATE)
)
_ATTEMPTS = 3


class Task(Protocol):
    """Something that sends frames until it is done, or has failed."""

    failure: str | None

    @property
    def done(self) -> bool:
        """Whether it has succeeded."""

    @property
    def wake_s(self) -> float:
        """When to poll next [s]."""

    def poll(self, now_s: float) -> Iterator[Frame]:
        """Frames to send now."""

    def on_response(self, data: bytes) -> None:
        """Take in an answer of the cell."""


class UpdateError(Exception):
    """A cell has not taken the firmware; the message has the reason."""


class Waiting:
    """A task that ends from outside, or in time: with `failure`, or well without one.

    Without a limit it may wait for ever.
    """

    def __init__(self, limit_s: float = float("inf"), failure: str | None = None) -> None:
        self.done = False
        self.failure: str | None = None
        self._limit_s = limit_s
        self._end_s: float | None = None if limit_s < float("inf") else limit_s
        self._text = failure

    @property
    def wake_s(self) -> float:
        """When it gives up [s]; at once for the first time, from which its limit counts."""
        return float("-inf") if self._end_s is None else self._end_s

    def poll(self, now_s: float) -> Iterator[Frame]:
        """Nothing is sent."""
        if self._end_s is None:
            self._end_s = now_s + self._limit_s
        if now_s >= self._end_s:
            self.failure, self.done = self._text, self._text is None
        return iter(())

    def on_response(self, data: bytes) -> None:
        """Nothing is waited for but its end."""


class CellUpdate:
    """Brings a bundle into a cell, and once `may_start` has it started, tested and confirmed.

    `stage` is what it does now, `share` how much of the bundle has arrived; `loaded`, `finished`
    and `failure` are how it stands. Without IO: `on_frame`, `poll`, `wake_s`.
    """

    def __init__(self, node_id: int, bundle: Bundle) -> None:
        self.node_id = node_id
        self.bundle = bundle
        self.may_start = False
        self.loaded = False
        self.finished = False
        self.failure: str | None = None
        self.repeated = 0
        self.restarts = 0
        self._download: BlockDownload | None = None
        self._gate = Waiting()
        self._boot: Waiting | None = None
        self._script = self._steps()
        self._task: Task = next(self._script)

    @property
    def over(self) -> bool:
        """Whether nothing more comes of it."""
        return self.finished or self.failure is not None

    @property
    def share(self) -> float:
        """How much of the bundle has arrived, 0 to 1."""
        if self.loaded:
            return 1.0
        return self._download.acknowledged / len(self.bundle.data) if self._download else 0.0

    @property
    def wake_s(self) -> float:
        """When to poll next, if nothing comes before [s]."""
        if self.over:
            return float("inf")
        return float("-inf") if self._task.done or self._task.failure else self._task.wake_s

    def start(self) -> None:
        """The new firmware may be started as soon as it is there."""
        self.may_start = self._gate.done = True

    def give_up(self, reason: str) -> None:
        """Leave the cell with the firmware that it has."""
        if not self.over:
            self.failure = reason

    def on_frame(self, frame: Frame) -> None:
        """Take in a frame of this cell."""
        if frame.can_id == cob.SDO_RESPONSE_BASE + self.node_id:
            self._task.on_response(frame.data)
        elif self._boot is not None and frame == nmt.heartbeat(self.node_id, nmt.INITIALISING):
            self._boot.done = True

    def poll(self, now_s: float) -> Iterator[Frame]:
        """Frames to send now; who takes fewer gets the rest with the next call."""
        while not self.over and (self._task.done or self._task.failure):
            self._next()
        if not self.over and self._task.wake_s <= now_s:
            yield from self._task.poll(now_s)

    def _next(self) -> None:
        try:
            self._task = next(self._script)
        except StopIteration:
            self.finished = True
        except UpdateError as error:
            self.failure = str(error)

    # The script

    def _steps(self) -> Generator[Task, None, None]:
        yield from self._load()
        self.loaded = True
        yield self._gate
        self._boot = Waiting(_BOOT_S, f"it has not come back within {_BOOT_S:g} s")
        refused = yield from self._attempt(codes.START)
        if refused and not self._boot.done:
            raise UpdateError(refused)
        yield self._boot
        _check(self._boot)
        yield from self._verify()
        yield Waiting(_TEST_S)
        refused = yield from self._attempt(codes.CONFIRM)
        if (yield from self._read(indices.UPDATE, 8)):
            raise UpdateError(refused or "it is on trial still")
        yield from self._verify()

    def _load(self) -> Generator[Task, None, None]:
        """Clear and send, again if the way was the reason that it failed."""
        for _ in range(_ATTEMPTS):
            refused = yield from self._attempt(codes.CLEAR)
            if refused:
                raise UpdateError(refused)
            task = BlockDownload(self.node_id, indices.PROGRAM_DATA, 1, self.bundle.data)
            self._download = task
            yield task
            self.repeated += task.repeated
            if task.done:
                return
            reason = yield from self._reason()
            if reason or task.abort not in (None, *_PASSING):
                raise UpdateError(reason or task.failure)
            self.restarts += 1
        raise UpdateError(f"{task.failure}, {_ATTEMPTS} times")

    def _verify(self) -> Generator[Task, None, None]:
        """What has come back is what was sent."""
        found = yield from self._read(indices.PROGRAM_IDENTIFICATION, 1)
        if found != self.bundle.identification:
            reason = yield from self._reason()
            raise UpdateError(reason or f"it came back with other firmware ({found:08X})")

    def _attempt(self, command: int) -> Generator[Task, None, str | None]:
        """Why a command was refused, None if it was not.

        Who has done it and was not understood refuses it when it comes again.
        """
        write = Setting(indices.PROGRAM_CONTROL, 1, command)
        task = SdoClient(self.node_id, [write], answer_within_s=_FLASH_S)
        yield task
        if task.done:
            return None
        reason = yield from self._reason()
        return reason or task.failure

    def _read(self, index: int, sub: int) -> Generator[Task, None, int]:
        task = SdoClient(self.node_id, [Read(index, sub)], answer_within_s=_FLASH_S)
        yield task
        _check(task)
        return task.answers[index, sub]

    def _reason(self) -> Generator[Task, None, str | None]:
        """What the cell says of its refusal, None if it says nothing."""
        task = SdoClient(self.node_id, [Read(indices.FLASH_STATUS, 1)], answer_within_s=_FLASH_S)
        yield task
        status = task.answers.get((indices.FLASH_STATUS, 1))
        return None if status is None else reason_text(status)


def _check(task: Task) -> None:
    """Raises UpdateError for a task that has failed."""
    if not task.done:
        raise UpdateError(task.failure)
