"""The way of one cell from the firmware that it has to another, as a script of requests.

An image goes into the cell by SDO block download (CiA 301, 7.2.4.2.9 to 7.2.4.2.12).
"""

import binascii
from collections.abc import Generator, Iterator
from typing import Protocol

from mdms_host.can_link.sdo_client import Read, SdoClient, Setting
from mdms_host.flashing.bundles import Bundle
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt, sdo, update
from mdms_protocol.codecs.frame import Frame

REASONS = {
    update.NO_ROOM: "its board has no room for a second firmware",
    update.NO_KEY: "it has no update key; mdms commission --key FILE gives it one",
    update.NO_BUNDLE: "the received bytes are no bundle",
    update.FOREIGN: "the bundle is signed with another array's key",
    update.FORGED: "the bundle differs from the signed one",
    update.OTHER_BOARD: "the bundle is for other boards",
    update.OTHER_BYTECODE: "the bundle is for another version of MicroPython or another processor",
    update.OLDER: "the bundle is older than its firmware; --allow-older signs that this is meant",
    update.REPLAYED: "the bundle, or a later one, has been used before",
    update.TOO_LARGE: "the bundle is larger than its slot",
    update.TRUNCATED: "the bundle is not whole",
    update.DAMAGED: "its flash differs from the signed bundle",
    update.DRIVING: "its motors are on, or brake still; turn them off first: mdms stop",
    update.FLASH_FAILED: "its flash cannot be written",
    update.NOT_CLEARED: "its slot was not cleared before",
    update.NOTHING_TO_START: "it has no new firmware to start",
    update.NOT_ON_TRIAL: "no firmware is on trial",
    update.SELF_TEST: "it does not pass its self-test",
    update.ROLLED_BACK: "the new firmware did not prove itself, and the one before runs again",
    update.OTHER_KEY: "it has another array's key, which goes over USB only: remove update.key",
    update.ON_TRIAL: "other firmware is on trial; it ends within a minute",
}


def reason_text(status: int) -> str | None:
    """The reason that 0x1F57:1 gives, in words; None for none."""
    number = update.reason_of(status)
    return REASONS.get(number, f"reason {number}") if number else None


_SEGMENT = 7
#: Erasing flash may keep a cell from an answer for so long [s]; it aborts a second after the last
#: segment that it has seen.
_ANSWER_S = 0.7
#: The end is answered when all is read again from flash.
_END_S = 5.0
_NUDGES = 3
#: Blocks in a row of which nothing has arrived.
_BARREN = 10


class BlockDownload:
    """Sends segments of a block until the cell's count of them says otherwise; without IO.

    `failure` is the reason why it has ended early, and `abort` the cell's code, if it gave one.
    `repeated` counts segments that were sent again, `acknowledged` bytes that have arrived.
    """

    def __init__(self, node_id: int, index: int, sub: int, data: bytes) -> None:
        self.done = False
        self.failure: str | None = None
        self.abort: int | None = None
        self.repeated = 0
        self.acknowledged = 0
        self._can_id = cob.SDO_REQUEST_BASE + node_id
        self._place = index.to_bytes(2, "little") + bytes((sub,))
        self._data = data
        self._block_size = 0
        self._sent = 0
        self._highest = 0
        self._awaits: int | None = None
        self._due_s = 0.0
        self._asked = 0
        self._next_size: int | None = None
        self._barren = 0

    @property
    def wake_s(self) -> float:
        """When to poll next, if no answer comes before [s]."""
        return float("inf") if self.done or self.failure else self._due_s

    def poll(self, now_s: float) -> Iterator[Frame]:
        """Frames to send now; who takes fewer gets the rest with the next call."""
        if self.done or self.failure:
            return
        if self._next_size is not None:
            self._await_repetitions(now_s, self._next_size)
        if self._awaits is None and self._block_size:
            yield from self._segments(now_s)
        elif now_s >= self._due_s:
            yield from self._ask(now_s)

    def on_response(self, data: bytes) -> None:
        """Take in an answer of the cell; other frames are left alone."""
        if len(data) != 8 or self.done or self.failure:
            return
        if data[0] == sdo.ABORT:
            self.abort = int.from_bytes(data[4:], "little")
            self.failure = f"it ends the transfer (abort code 0x{self.abort:08X})"
            if self.abort == sdo.INVALID_SEQUENCE:
                # Ours are valid: another client's request came between them.
                self.failure = "another program asks it amid the transfer; let that one end first"
        elif data[0] & sdo.SPECIFIER == sdo.BLOCK_DOWNLOAD_RESPONSE:
            self._on_block(data[0] & sdo.BLOCK_SUBCOMMAND, data)

    def _on_block(self, answers: int, data: bytes) -> None:
        if answers == sdo.BLOCK_INITIATE and not self._block_size and data[1:4] == self._place:
            self._begin_block(data[4])
        elif answers == sdo.BLOCK_ACKNOWLEDGE and self._awaits == sdo.BLOCK_ACKNOWLEDGE:
            self._on_acknowledge(data[1], data[2])
        elif answers == sdo.BLOCK_END and self._awaits == sdo.BLOCK_END:
            self.done = True

    def _on_acknowledge(self, sequence: int, size: int) -> None:
        """The first one counts; those of repetitions are waited for, so that none counts later."""
        if self._next_size is None:
            self._next_size = size
            self.acknowledged = min(self.acknowledged + sequence * _SEGMENT, len(self._data))
            self._barren = 0 if sequence else self._barren + 1
        if self._barren == _BARREN:
            self.failure = f"none of {_BARREN} blocks in a row has arrived"
        elif self._asked:
            self._asked, self._due_s = self._asked - 1, 0.0
        else:
            self._begin_block(self._next_size)

    def _await_repetitions(self, now_s: float, size: int) -> None:
        """Begin the next block at last where one of them was lost."""
        if not self._due_s:
            self._due_s = now_s + _ANSWER_S
        elif now_s >= self._due_s:
            self._begin_block(size)

    def _begin_block(self, size: int) -> None:
        if not 1 <= size <= sdo.BLOCK_SEQUENCE:
            self.failure = f"it asks for blocks of {size} segments"
            return
        whole = self._block_size and self.acknowledged == len(self._data)
        self._block_size, self._sent, self._asked, self._due_s = size, 0, 0, 0.0
        self._next_size = None
        self._awaits = sdo.BLOCK_END if whole else None

    def _segments(self, now_s: float) -> Iterator[Frame]:
        while self._awaits is None:
            self._sent += 1
            frame = self._segment(self._sent)
            start = self.acknowledged + (self._sent - 1) * _SEGMENT
            self.repeated += start < self._highest
            self._highest = max(self._highest, start + _SEGMENT)
            if self._sent == self._block_size or frame.data[0] & sdo.BLOCK_LAST:
                self._awaits, self._due_s = sdo.BLOCK_ACKNOWLEDGE, now_s + _ANSWER_S
            yield frame

    def _segment(self, sequence: int) -> Frame:
        start = self.acknowledged + (sequence - 1) * _SEGMENT
        piece = self._data[start : start + _SEGMENT]
        last = sdo.BLOCK_LAST if start + _SEGMENT >= len(self._data) else 0
        return Frame(self._can_id, bytes((sequence | last,)) + piece.ljust(_SEGMENT, b"\0"))

    def _ask(self, now_s: float) -> Iterator[Frame]:
        """Open or end the transfer; or send the last segment again, by which a block is counted."""
        if self._asked == _NUDGES:
            self.failure = "it does not answer"
            return
        self._asked += 1
        self._due_s = now_s + _ANSWER_S
        if not self._block_size:
            # Once, as the end: in a transfer that is open it would count for a segment.
            self._asked, self._due_s = _NUDGES, now_s + _NUDGES * _ANSWER_S
            command = sdo.BLOCK_DOWNLOAD | sdo.BLOCK_CRC | sdo.BLOCK_SIZE_TOLD
            size = len(self._data).to_bytes(4, "little")
            yield Frame(self._can_id, bytes((command,)) + self._place + size)
        elif self._awaits == sdo.BLOCK_END:
            # Once: a cell that has ended the transfer would refuse another end.
            self._asked, self._due_s = _NUDGES, now_s + _END_S
            yield self._end()
        else:
            self.repeated += 1
            yield self._segment(self._sent)

    def _end(self) -> Frame:
        unused = -len(self._data) % _SEGMENT
        crc = binascii.crc_hqx(self._data, 0)
        command = sdo.BLOCK_DOWNLOAD | unused << 2 | sdo.BLOCK_END
        return Frame(self._can_id, bytes((command, crc & 0xFF, crc >> 8)) + bytes(5))


#: Writing the record to flash may take a cell this long.
_FLASH_S = 2.0
#: A reset, MicroPython's start, and the claim of the node id.
_BOOT_S = 20.0
#: A cell on trial runs for a while before it is confirmed, so that it may fail.
_TEST_S = 0.5
#: The time of a served table may pass more slowly than ours.
_TESTS = 10
#: A transfer is begun anew so often without getting further than before.
_ATTEMPTS = 3
#: A program that has asked the cell amid a transfer has its other answers by then.
_PAUSE_S = 1.0
_RESTARTED = "it restarted amid the transfer; look at its supply, then run the same again"


class UpdateTask(Protocol):
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

    `stage` is the present step, `share` how much of the bundle has arrived; `loaded`, `finished`
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
        self._restarted = False
        self._script = self._steps()
        self._task: UpdateTask = next(self._script)

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
        elif frame == nmt.heartbeat(self.node_id, nmt.INITIALISING):
            if self._boot is not None:
                self._boot.done = True
            self._restarted = True
            if self._download is not None and self._task is self._download:
                # Other segments would be requests of another kind to it.
                self._download.failure = _RESTARTED

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

    def _steps(self) -> Generator[UpdateTask, None, None]:
        yield from self._load()
        self.loaded = True
        yield self._gate
        if self._restarted:
            # It has forgotten the bundle while it waited.
            yield from self._load()
        self._boot = Waiting(_BOOT_S, f"it has not come back within {_BOOT_S:g} s")
        refused = yield from self._attempt(update.START)
        if refused and not self._boot.done:
            raise UpdateError(refused)
        yield self._boot
        try:
            yield from self._verify()
        except UpdateError:
            # Its boot-up message alone may be lost.
            _check(self._boot)
            raise
        for _ in range(_TESTS):
            yield Waiting(_TEST_S)
            refused = yield from self._attempt(update.CONFIRM)
            if refused != REASONS[update.SELF_TEST]:
                break
        if (yield from self._read(indices.UPDATE, 8)):
            raise UpdateError(refused or "it is on trial still")
        yield from self._verify()

    def _load(self) -> Generator[UpdateTask, None, None]:
        """Clear and send, again if the cell has no reason, as long as that gets further."""
        attempts, furthest = 0, 0
        while attempts < _ATTEMPTS:
            self._restarted = False
            refused = yield from self._attempt(update.CLEAR)
            if refused:
                raise UpdateError(refused)
            task = BlockDownload(self.node_id, indices.PROGRAM_DATA, 1, self.bundle.data)
            self._download = task
            yield task
            self.repeated += task.repeated
            if task.done:
                return
            reason = yield from self._reason()
            if reason and not self._restarted:
                raise UpdateError(reason)
            self.restarts += 1
            attempts = 1 if task.acknowledged > furthest else attempts + 1
            furthest = max(furthest, task.acknowledged)
            yield Waiting(_PAUSE_S)
        raise UpdateError(f"{task.failure} ({attempts} times without getting further)")

    def _verify(self) -> Generator[UpdateTask, None, None]:
        """The answer repeats the request."""
        found = yield from self._read(indices.PROGRAM_IDENTIFICATION, 1)
        if found != self.bundle.identification:
            reason = yield from self._reason()
            raise UpdateError(reason or f"it came back with other firmware ({found:08X})")

    def _attempt(self, command: int) -> Generator[UpdateTask, None, str | None]:
        """Why a command was refused, None if it was not.

        A cell that has done it, and whose answer was lost, refuses it when it comes again.
        """
        write = Setting(indices.PROGRAM_CONTROL, 1, command)
        for _ in range(_ATTEMPTS):
            task = SdoClient(self.node_id, [write], answer_within_s=_FLASH_S)
            yield task
            if task.done:
                return None
            reason = yield from self._reason()
            if reason or task.abort != sdo.WRONG_STATE:
                break
            # After a transfer was broken off, a cell takes writes for segments of it for a while.
            yield Waiting(_PAUSE_S)
        return reason or task.failure

    def _read(self, index: int, sub: int) -> Generator[UpdateTask, None, int]:
        task = SdoClient(self.node_id, [Read(index, sub)], answer_within_s=_FLASH_S)
        yield task
        _check(task)
        return task.answers[index, sub]

    def _reason(self) -> Generator[UpdateTask, None, str | None]:
        """The cell's reason for its refusal, None without one."""
        task = SdoClient(self.node_id, [Read(indices.FLASH_STATUS, 1)], answer_within_s=_FLASH_S)
        yield task
        status = task.answers.get((indices.FLASH_STATUS, 1))
        return None if status is None else reason_text(status)


def _check(task: UpdateTask) -> None:
    """Raises UpdateError for a task that has failed."""
    if not task.done:
        raise UpdateError(task.failure)
