"""Firmware over the bus (CiA 302-3): cleared, received, started on trial, confirmed.

0x1F51 takes the commands, and 0x1F50 the bundle. 0x1F57 gives the reason of the last refusal, and
0x1F56 the running firmware. 0x3030 answers the host's questions before an update.
"""

import hashlib

from mdms_cell import ticks
from mdms_protocol import indices
from mdms_protocol.codecs import bundle, sdo, update
from mdms_protocol.version import VERSION

#: Firmware on trial without a confirmation for so long makes way for the one before.
TRIAL_MS = 60_000
#: The answer to the command leaves before the restart.
RESTART_MS = 50

_CODES = {
    update.DRIVING: sdo.WRONG_STATE,
    update.NOT_CLEARED: sdo.WRONG_STATE,
    update.NOTHING_TO_START: sdo.WRONG_STATE,
    update.NOT_ON_TRIAL: sdo.WRONG_STATE,
    update.ON_TRIAL: sdo.WRONG_STATE,
    update.SELF_TEST: sdo.WRONG_STATE,
    update.FLASH_FAILED: sdo.HARDWARE_ERROR,
    update.TOO_LARGE: sdo.TOO_LONG,
    update.TRUNCATED: sdo.TOO_SHORT,
}


class Update:
    """Ties the objects to the board's `slots`.

    `board` also has `number`, `bytecode`, `slots_room()`, `image_room()` and `restart()`.
    `driving()` is whether a motor is on. `sound()` is whether the cell passes its self-test.
    `attend()` is the time [ms].
    """

    def __init__(self, objects, board, driving, sound, attend):
        self._board = board
        self._slots = board.slots
        self._driving = driving
        self._sound = sound
        self._attend = attend
        self._target = (board.number, board.bytecode, bundle.version_number(VERSION))
        self._reason = update.ROLLED_BACK if self._slots.record.rolled_back else 0
        self._cleared = False
        self._receiving = False
        self._received = None
        self._asked = False
        self._trial_ms = None
        self._restart_ms = None
        self._tie(objects)

    def _tie(self, objects):
        slots, board = self._slots, self._board
        # Found once: a file system takes long to count its blocks, too long under a turning wheel.
        room = board.slots_room()
        objects.tie(indices.PROGRAM_DATA, 1, sink=self._open)
        objects.tie(indices.UPDATE, 1, sink=self._open_key)
        objects.tie(indices.PROGRAM_CONTROL, 1, _running, self._control)
        objects.tie(indices.PROGRAM_IDENTIFICATION, 1, self._identify)
        objects.tie(indices.FLASH_STATUS, 1, self._status)
        reads = (
            lambda: int.from_bytes(key_id(slots.key()), "little"),
            lambda: board.number,
            lambda: board.bytecode,
            lambda: room,
            lambda: slots.record.counter,
            lambda: slots.running,
            lambda: int(slots.on_trial),
        )
        for sub, read in enumerate(reads, 2):
            objects.tie(indices.UPDATE, sub, read)

    @property
    def busy(self):
        """Whether no axis may be enabled: firmware comes in, is on trial, or about to start."""
        return self._receiving or self._slots.on_trial or self._restart_ms is not None

    def poll(self, now_ms):
        """Restart when it is time for it; return in how many milliseconds that is."""
        wait_ms = self._trial_left_ms(now_ms)
        if self._restart_ms is not None:
            wait_ms = min(wait_ms, ticks.diff(self._restart_ms, now_ms))
        if wait_ms <= 0:
            self._restart_ms = None
            self._trial_ms = None
            self._board.restart()
            return ticks.IDLE_MS
        return wait_ms

    def _trial_left_ms(self, now_ms):
        if not self._slots.on_trial:
            return ticks.IDLE_MS
        if self._trial_ms is None:
            self._trial_ms = ticks.after(now_ms, TRIAL_MS)
        return ticks.diff(self._trial_ms, now_ms)

    # Reads

    def _identify(self):
        self._asked = True
        return self._slots.identification

    def _status(self):
        return update.status(self._reason, self._receiving)

    # Commands

    def _control(self, command):
        if command == update.CLEAR:
            self._clear()
        elif command == update.START:
            self._start()
        elif command == update.CONFIRM:
            self._confirm()
        elif command == update.RESET:
            self._refuse_while_driving()
            self._restart_soon()
        else:
            raise sdo.AbortError(sdo.INVALID_VALUE)

    def _clear(self):
        self._refuse_while_driving()
        if self._slots.on_trial:
            raise self._refusal(update.ON_TRIAL)
        self._received = None
        self._store(self._slots.clear)
        self._reason = 0
        self._cleared = True

    def _start(self):
        self._refuse_while_driving()
        head = self._received
        if head is None:
            raise self._refusal(update.NOTHING_TO_START)
        self._store(lambda: self._slots.arm(head.digest, head.counter))
        self._restart_soon()

    def _confirm(self):
        """Confirm the running firmware, which has come up, was identified, and is sound."""
        if not self._slots.on_trial:
            raise self._refusal(update.NOT_ON_TRIAL)
        if not self._asked or not self._sound():
            raise self._refusal(update.SELF_TEST)
        self._store(self._slots.confirm)
        self._reason = 0

    def _restart_soon(self):
        self._restart_ms = ticks.after(self._attend(), RESTART_MS)

    # Data

    def _open(self, _size):
        """A sink for a bundle."""
        self._refuse_while_driving()
        if not self._cleared:
            raise self._refusal(update.NOT_CLEARED)
        self._cleared, self._receiving = False, True
        return _Receipt(self._slots, self._admit, self._on_received, self._refusal)

    def _admit(self, data):
        """The head of a bundle that begins so; raises AbortError if it is not for this cell."""
        slots = self._slots
        counter, room = slots.record.counter, (self._board.slots_room(), self._board.image_room())
        reason = _refusal_of(data, slots.key(), self._target, counter, room)
        if reason:
            raise self._refusal(reason)
        return bundle.unpack(data)

    def _on_received(self, head):
        """Keep the head of a whole bundle; None means that the bundle was thrown away."""
        self._receiving = False
        self._received = head

    def _open_key(self, size):
        """A sink for the array's key, which takes the place of none."""
        if size is not None and size != update.KEY_SIZE:
            raise sdo.AbortError(sdo.WRONG_LENGTH)
        return _KeySink(self._keep_key)

    def _keep_key(self, key):
        self._refuse_while_driving()
        kept = self._slots.key()
        if kept == key:
            return
        if kept:
            raise self._refusal(update.OTHER_KEY)
        self._store(lambda: self._slots.keep_key(key))

    # Refusals

    def _refuse_while_driving(self):
        """A wheel that brakes still counts, too."""
        if self._driving() or not self._slots.may_write():
            raise self._refusal(update.DRIVING)

    def _store(self, action):
        try:
            action()
        except OSError:
            raise self._refusal(update.FLASH_FAILED)  # noqa: B904 - MicroPython has no `from`

    def _refusal(self, reason):
        """The error for a refusal, whose reason stands in 0x1F57 from now on."""
        self._reason = reason
        return sdo.AbortError(_CODES.get(reason, sdo.INVALID_VALUE))


class _KeySink:
    """A key on its way from the client."""

    def __init__(self, keep):
        self._keep = keep
        self._key = b""

    def write(self, piece):
        """Take some bytes; raises AbortError if they are too many."""
        self._key += piece
        if len(self._key) > update.KEY_SIZE:
            raise sdo.AbortError(sdo.TOO_LONG)

    def finish(self):
        """Keep the key; raises AbortError."""
        if len(self._key) < update.KEY_SIZE:
            raise sdo.AbortError(sdo.TOO_SHORT)
        self._keep(self._key)

    def cancel(self):
        """Leave the key as it is."""


def _running():
    return update.START


class _Receipt:
    """Takes a bundle in pieces.

    `admit(data)` returns the head of a bundle that is for this cell, and `received(head)` takes it
    at the end. `refusal(reason)` returns an AbortError.
    """

    def __init__(self, slots, admit, received, refusal):
        self._slots = slots
        self._admit = admit
        self._received = received
        self._refusal = refusal
        self._start = b""
        self._slot = None

    def write(self, piece):
        """Take some bytes; raises AbortError."""
        slot = self._slot
        if slot is None:
            self._start += piece
            if len(self._start) < bundle.HEAD_SIZE:
                return
            slot = self._slot = self._open()
            piece, self._start = self._start[bundle.HEAD_SIZE :], b""
        slot.left -= len(piece)
        if slot.left < 0:
            raise self._refusal(update.TOO_LARGE)
        try:
            slot.file.write(piece)
        except OSError:
            raise self._refusal(update.FLASH_FAILED)  # noqa: B904 - MicroPython has no `from`

    def _open(self):
        try:
            return _Slot(self._admit(self._start), self._slots.create())
        except OSError:
            raise self._refusal(update.FLASH_FAILED)  # noqa: B904

    def finish(self):
        """End the bundle; raises AbortError if its bytes differ from the signed ones."""
        slot = self._slot
        if slot is None:
            known = self._start[:4] == bundle.MAGIC
            raise self._refusal(update.TRUNCATED if known else update.NO_BUNDLE)
        if slot.left:
            raise self._refusal(update.TRUNCATED)
        try:
            slot.file.close()
            found = self._slots.digest()
        except OSError:
            raise self._refusal(update.FLASH_FAILED)  # noqa: B904
        if found != (slot.head.size, slot.head.digest):
            raise self._refusal(update.DAMAGED)
        self._received(slot.head)

    def cancel(self):
        """Discard the received bytes."""
        self._received(None)
        if self._slot is None:
            return
        try:
            self._slot.file.close()
        except OSError:
            return  # the file is then incomplete, and is removed
        finally:
            self._slots.remove()


class _Slot:
    """The spare slot while it is written: the head of the bundle, and the bytes still to come."""

    def __init__(self, head, file):
        self.head = head
        self.file = file
        self.left = head.size


def key_id(key):
    """Four bytes that stand for a key and reveal nothing of it; zeros for none."""
    return sign(key, b"MDMS update key")[:4] if key else bytes(4)


def sign(key, data):
    """The code of some data under a key of at most 64 bytes: HMAC-SHA256 (RFC 2104)."""
    inner = hashlib.sha256(_padded(key, 0x36))
    inner.update(data)
    outer = hashlib.sha256(_padded(key, 0x5C))
    outer.update(inner.digest())
    return outer.digest()


def _padded(key, pad):
    return bytes(byte ^ pad for byte in key + bytes(64 - len(key)))


def _same(one, other):
    """Whether two codes are the same, in a time that does not depend on where they differ."""
    difference = len(one) ^ len(other)
    for place in range(min(len(one), len(other))):
        difference |= one[place] ^ other[place]
    return not difference


def _refusal_of(data, key, target, counter, room):
    """Return the reason to refuse a bundle with these first bytes, 0 to take it.

    `target` is board, bytecode and version number of this cell. `counter` is that of the last
    confirmed bundle. `room` is the size of a slot, and the memory for its image [bytes].
    """
    head = bundle.unpack(data)
    if head is None:
        return update.NO_BUNDLE
    if not key:
        return update.NO_KEY
    if head.key_id != key_id(key):
        return update.FOREIGN
    code = sign(key, data[: bundle.SIGNED_SIZE])
    if not _same(code, data[bundle.SIGNED_SIZE : bundle.HEAD_SIZE]):
        return update.FORGED
    return _unfit(head, *target) or _unwanted(head, target[2], counter, room)


def _unfit(head, board, bytecode, _version):
    if not head.boards >> board & 1:
        return update.OTHER_BOARD
    return update.OTHER_BYTECODE if head.bytecode != bytecode else 0


def _unwanted(head, version, counter, room):
    if head.counter <= counter:
        return update.REPLAYED
    if head.version < version and not head.flags & bundle.OLDER_ALLOWED:
        return update.OLDER
    return update.TOO_LARGE if head.size > room[0] or head.image_size > room[1] else 0
