"""Firmware over the bus (CiA 302-3): cleared, received, started on trial, confirmed.

0x1F51 takes the commands, 0x1F50 the bundle, 0x1F57 has the reason of the last refusal, 0x1F56
which firmware runs, and 0x3030 what a host has to ask before.
"""

from mdms_cell import ticks
from mdms_cell.update import admission
from mdms_cell.update.receipt import Receipt
from mdms_cell.update.signature import key_id
from mdms_protocol import indices
from mdms_protocol.codecs import sdo
from mdms_protocol.update import bundle, codes
from mdms_protocol.version import VERSION

#: Firmware on trial that nobody confirms for so long makes way for the one before.
TRIAL_MS = 60_000
#: The answer to the command leaves before the restart.
RESTART_MS = 50

_CODES = {
    codes.DRIVING: sdo.WRONG_STATE,
    codes.NOT_CLEARED: sdo.WRONG_STATE,
    codes.NOTHING_TO_START: sdo.WRONG_STATE,
    codes.NOT_ON_TRIAL: sdo.WRONG_STATE,
    codes.ON_TRIAL: sdo.WRONG_STATE,
    codes.SELF_TEST: sdo.WRONG_STATE,
    codes.FLASH_FAILED: sdo.HARDWARE_ERROR,
    codes.TOO_LARGE: sdo.TOO_LONG,
    codes.TRUNCATED: sdo.TOO_SHORT,
}


class Update:
    """Ties the objects to the board's `slots`.

    `board` has `number`, `bytecode`, `slots_room()`, `image_room()` and `restart()` besides.
    `driving()` is whether a motor is on, `sound()` whether the cell passes its self-test,
    `attend()` the time [ms].
    """

    def __init__(self, objects, board, driving, sound, attend):
        self._board = board
        self._slots = board.slots
        self._driving = driving
        self._sound = sound
        self._attend = attend
        self._target = (board.number, board.bytecode, bundle.version_number(VERSION))
        self._reason = codes.ROLLED_BACK if self._slots.record.rolled_back else 0
        self._cleared = False
        self._receiving = False
        self._received = None
        self._asked = False
        self._trial_ms = None
        self._restart_ms = None
        self._tie(objects)

    def _tie(self, objects):
        slots, board = self._slots, self._board
        objects.tie(indices.PROGRAM_DATA, 1, sink=self._open)
        objects.tie(indices.UPDATE, 1, sink=self._open_key)
        objects.tie(indices.PROGRAM_CONTROL, 1, _running, self._control)
        objects.tie(indices.PROGRAM_IDENTIFICATION, 1, self._identify)
        objects.tie(indices.FLASH_STATUS, 1, self._status)
        reads = (
            lambda: int.from_bytes(key_id(slots.key()), "little"),
            lambda: board.number,
            lambda: board.bytecode,
            board.slots_room,
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
        return codes.status(self._reason, self._receiving)

    # Commands

    def _control(self, command):
        if command == codes.CLEAR:
            self._clear()
        elif command == codes.START:
            self._start()
        elif command == codes.CONFIRM:
            self._confirm()
        elif command == codes.RESET:
            self._refuse_while_driving()
            self._restart_soon()
        else:
            raise sdo.AbortError(sdo.INVALID_VALUE)

    def _clear(self):
        self._refuse_while_driving()
        if self._slots.on_trial:
            raise self._refusal(codes.ON_TRIAL)
        self._received = None
        self._store(self._slots.clear)
        self._reason = 0
        self._cleared = True

    def _start(self):
        self._refuse_while_driving()
        head = self._received
        if head is None:
            raise self._refusal(codes.NOTHING_TO_START)
        self._store(lambda: self._slots.arm(head.digest, head.counter))
        self._restart_soon()

    def _confirm(self):
        """The firmware that runs stays: it has come up, was asked what it is, and is sound."""
        if not self._slots.on_trial:
            raise self._refusal(codes.NOT_ON_TRIAL)
        if not self._asked or not self._sound():
            raise self._refusal(codes.SELF_TEST)
        self._store(self._slots.confirm)
        self._reason = 0

    def _restart_soon(self):
        self._restart_ms = ticks.after(self._attend(), RESTART_MS)

    # Data

    def _open(self, _size):
        """A sink for a bundle."""
        self._refuse_while_driving()
        if not self._cleared:
            raise self._refusal(codes.NOT_CLEARED)
        self._cleared, self._receiving = False, True
        return Receipt(self._slots, self._admit, self._on_received, self._refusal)

    def _admit(self, data):
        """The head of a bundle that begins so; raises AbortError if it is not for this cell."""
        slots = self._slots
        counter, room = slots.record.counter, (self._board.slots_room(), self._board.image_room())
        reason = admission.refusal(data, slots.key(), self._target, counter, room)
        if reason:
            raise self._refusal(reason)
        return bundle.unpack(data)

    def _on_received(self, head):
        """The bundle is whole, or what has come of it is thrown away (None)."""
        self._receiving = False
        self._received = head

    def _open_key(self, size):
        """A sink for the array's key, which takes the place of none."""
        if size is not None and size != codes.KEY_SIZE:
            raise sdo.AbortError(sdo.WRONG_LENGTH)
        return _KeySink(self._keep_key)

    def _keep_key(self, key):
        self._refuse_while_driving()
        kept = self._slots.key()
        if kept == key:
            return
        if kept:
            raise self._refusal(codes.OTHER_KEY)
        self._store(lambda: self._slots.keep_key(key))

    # Refusals

    def _refuse_while_driving(self):
        """A wheel that brakes still counts, too."""
        if self._driving() or not self._slots.may_write():
            raise self._refusal(codes.DRIVING)

    def _store(self, action):
        try:
            action()
        except OSError:
            raise self._refusal(codes.FLASH_FAILED)  # noqa: B904 - MicroPython has no `from`

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
        if len(self._key) > codes.KEY_SIZE:
            raise sdo.AbortError(sdo.TOO_LONG)

    def finish(self):
        """Keep the key; raises AbortError."""
        if len(self._key) < codes.KEY_SIZE:
            raise sdo.AbortError(sdo.TOO_SHORT)
        self._keep(self._key)

    def cancel(self):
        """Leave the key as it is."""


def _running():
    return codes.START
