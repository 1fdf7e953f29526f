"""Settings that outlive the power supply (CiA 301, 7.5.2.13 and 7.5.2.14: 0x1010 and 0x1011).

A save goes to the bank of the memory that is not in use and counts only when all of it is there, so
that power may fail at any byte: what was saved before stays valid.

The memory has `read(bank)`, which returns the whole bank, `erase(bank)` and
`write(bank, offset, data)`, and raises OSError where it fails.
"""

from mdms_cell.canopen.storage import restoration, saved
from mdms_protocol import indices, record
from mdms_protocol.codecs import sdo

SOURCE_SETTINGS = 8
SETTINGS_LOST = 0x6310


_SAVE = 0x65766173
_LOAD = 0x64616F6C
#: The flags of the entries that each sub-index stands for.
_GROUPS = {
    1: record.STORED_COMMUNICATION | record.STORED_APPLICATION,
    2: record.STORED_COMMUNICATION,
    3: record.STORED_APPLICATION,
}
#: What reading returns: saved on command, not by itself; defaults can be restored.
_ON_COMMAND = 1


class Store:
    """The saved settings; without a memory (None) nothing is saved and saving is refused."""

    def __init__(self, memory):
        self._memory = memory
        self._bank = 0
        self._sequence = 0
        self._values = b""
        if memory is not None:
            self._bank, self._sequence, self._values = saved.newest(memory)

    def node_id(self):
        """The saved node id, or None."""
        return saved.node_id_of(self._values)

    def restore(self, objects, flags):
        """Give the entries that have one of these flags their saved values.

        Returns (index, sub-index) of the saved values that were not taken; see `restoration`.
        """
        return restoration.restore(self._values, objects, flags)

    def save(self, objects, flags):
        """Save the entries that have one of these flags; raises AbortError."""
        self._write(saved.without(self._values, flags) + saved.of(objects, flags))

    def drop(self, flags):
        """Give up the saved values of these entries; raises AbortError."""
        self._write(saved.without(self._values, flags))

    def save_node_id(self, node_id):
        """Save the node id; raises AbortError."""
        self._write(saved.with_node_id(self._values, node_id))

    def _write(self, values):
        if self._memory is None:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        saved.write(self._memory, 1 - self._bank, self._sequence + 1, values)
        self._bank = 1 - self._bank
        self._sequence += 1
        self._values = values


class Parameters:
    """Ties 0x1010 and 0x1011 to the store; `driving()` returns whether motors are on.

    Erasing flash stops the processor, so nothing is stored while they are. Saved values that do not
    fit are reported to `emcy`, with the first of them and their number, until they are given up.
    """

    def __init__(self, objects, store, driving, emcy):
        self._objects = objects
        self._store = store
        self._driving = driving
        self._emcy = emcy
        self._misfits = []
        objects.watch(indices.STORE, self._on_store)
        objects.watch(indices.RESTORE, self._on_restore)

    def restore(self, flags):
        """Give the entries that have one of these flags their saved values."""
        self._misfits = self._store.restore(self._objects, flags)
        self._report()

    def _report(self):
        if not self._misfits:
            self._emcy.clear(SOURCE_SETTINGS)
            return
        index, sub = self._misfits[0]
        detail = bytes((index & 0xFF, index >> 8, sub, min(len(self._misfits), 0xFF)))
        self._emcy.report(SOURCE_SETTINGS, SETTINGS_LOST, detail)

    def _on_store(self, index, sub):
        self._take(index, sub, _SAVE)
        self._store.save(self._objects, _GROUPS[sub])
        self._give_up(_GROUPS[sub])

    def _on_restore(self, index, sub):
        self._take(index, sub, _LOAD)
        self._store.drop(_GROUPS[sub])
        self._give_up(_GROUPS[sub])

    def _give_up(self, flags):
        """Saved values with these flags, and those of no entry, are there no more."""
        self._misfits = restoration.remaining(self._misfits, flags)
        self._report()

    def _take(self, index, sub, expected):
        signature = self._objects.number(index, sub)
        self._objects.put(index, sub, _ON_COMMAND)
        if signature != expected:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        if self._driving():
            raise sdo.AbortError(sdo.WRONG_STATE)
