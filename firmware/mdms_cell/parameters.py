"""Store and restore by SDO (CiA 301, 7.5.2.13 and 7.5.2.14: 0x1010 and 0x1011)."""

from mdms_protocol import record, sdo

STORE = 0x1010
RESTORE = 0x1011

_SAVE = 0x65766173
_LOAD = 0x64616F6C
#: The flags of the entries that each sub-index stands for.
_GROUPS = {
    1: record.STORED_COMMUNICATION | record.STORED_APPLICATION,
    2: record.STORED_COMMUNICATION,
    3: record.STORED_APPLICATION,
}
#: What reading tells: saved on command, not by itself; defaults can be restored.
_ON_COMMAND = 1


class Parameters:
    """Ties 0x1010 and 0x1011 to the store; `driving()` tells whether motors are on.

    Erasing flash stops the processor, so nothing is stored while they are.
    """

    def __init__(self, objects, store, driving):
        self._objects = objects
        self._store = store
        self._driving = driving
        objects.watchers[STORE] = self._on_store
        objects.watchers[RESTORE] = self._on_restore

    def _on_store(self, index, sub):
        self._take(index, sub, _SAVE)
        self._store.save(self._objects, _GROUPS[sub])

    def _on_restore(self, index, sub):
        self._take(index, sub, _LOAD)
        self._store.forget(_GROUPS[sub])

    def _take(self, index, sub, expected):
        signature = self._objects.number(index, sub)
        self._objects.put(index, sub, _ON_COMMAND)
        if signature != expected:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        if self._driving():
            raise sdo.AbortError(sdo.WRONG_STATE)
