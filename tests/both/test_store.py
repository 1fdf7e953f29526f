"""Saved settings: what comes back, and that power may fail at any byte of a save."""

import binascii

from refusal import code_of

from mdms_cell.canopen.objects import Objects, find
from mdms_cell.canopen.store import Store
from mdms_protocol import record, sdo

SIZE = 256
ALL = record.STORED_COMMUNICATION | record.STORED_APPLICATION


class PowerLost(Exception):  # noqa: N818 - an event of the test
    """The supply has failed."""


class Memory:
    """Two banks; after `budget` more bytes the supply fails, amid what is being written."""

    def __init__(self):
        self.banks = [bytearray(b"\xff" * SIZE), bytearray(b"\xff" * SIZE)]
        self.budget = None
        self.broken = False

    def read(self, bank):
        return self.banks[bank]

    def erase(self, bank):
        self._put(bank, 0, b"\xff" * SIZE)

    def write(self, bank, offset, data):
        if self.broken:
            raise OSError(5)
        self._put(bank, offset, data)

    def _put(self, bank, offset, data):
        for place in range(len(data)):
            if self.budget is not None:
                if self.budget == 0:
                    raise PowerLost()
                self.budget -= 1
            self.banks[bank][offset + place] = data[place]


def defaults(node_id=5):
    objects = Objects()
    objects.reset(node_id, ALL | record.FROM_NODE)
    return objects


def restored(memory, flags=ALL):
    objects = defaults()
    Store(memory).restore(objects, flags)
    return objects


def saved():
    """A setpoint timeout of 77 ms that is saved: its memory, dictionary and store."""
    memory = Memory()
    objects = defaults()
    store = Store(memory)
    objects.put(0x3000, 0, 77)
    store.save(objects, ALL)
    return memory, objects, store


def test_what_was_saved_comes_back():
    memory = Memory()
    objects = defaults()
    objects.put(0x3000, 0, 77)
    objects.put(0x2809, 0, -3)
    objects.put(0x1017, 0, 250)
    Store(memory).save(objects, ALL)
    again = restored(memory)
    assert again.data == objects.data


def test_empty_and_foreign_memory_is_no_settings():
    memory = Memory()
    assert restored(memory).data == defaults().data
    memory.banks[0][:] = bytes(SIZE)
    memory.banks[1][:] = bytes([place & 0xFF for place in range(SIZE)])
    assert restored(memory).data == defaults().data


def test_groups_are_saved_and_forgotten_apart():
    memory = Memory()
    objects = defaults()
    objects.put(0x3000, 0, 77)
    objects.put(0x1017, 0, 250)
    store = Store(memory)
    store.save_node_id(9)
    store.save(objects, record.STORED_APPLICATION)
    assert restored(memory).number(0x1017) == 100
    store.save(objects, record.STORED_COMMUNICATION)
    store.forget(record.STORED_APPLICATION)
    again = restored(memory)
    assert (again.number(0x3000), again.number(0x1017)) == (50, 250)
    assert Store(memory).node_id() == 9


def test_identifiers_that_were_not_changed_follow_the_node_id():
    memory = Memory()
    Store(memory).save(defaults(5), ALL)
    objects = defaults(6)
    Store(memory).restore(objects, ALL)
    assert objects.number(0x1400, 1) == 0x206


def test_power_may_fail_at_any_byte_of_a_save():
    spent = 0
    outcomes = []
    while True:
        memory, objects, store = saved()
        objects.put(0x3000, 0, 88)
        memory.budget = spent
        try:
            store.save(objects, ALL)
        except PowerLost:
            outcomes.append(restored(memory).number(0x3000))
            spent += 1
            continue
        assert restored(memory).number(0x3000) == 88
        break
    assert len(outcomes) > SIZE
    assert set(outcomes) == {77}


def test_save_goes_on_after_a_failure_of_power():
    memory, objects, store = saved()
    memory.budget = 10
    try:
        store.save(objects, ALL)
    except PowerLost:
        memory.budget = None
    objects.put(0x3000, 0, 99)
    Store(memory).save(objects, ALL)
    assert restored(memory).number(0x3000) == 99


def test_any_wrong_byte_falls_back_to_the_save_before():
    memory = Memory()
    objects = defaults()
    store = Store(memory)
    for timeout_ms in (77, 88):
        objects.put(0x3000, 0, timeout_ms)
        store.save(objects, ALL)
    newer = memory.banks[0] if memory.banks[0][4] == 2 else memory.banks[1]
    for place in range(26):
        newer[place] ^= 0x10
        assert restored(memory).number(0x3000) == 77
        newer[place] ^= 0x10
    assert restored(memory).number(0x3000) == 88


def test_failing_memory_is_told_and_changes_nothing():
    memory, objects, store = saved()
    memory.broken = True
    objects.put(0x3000, 0, 88)
    assert code_of(store.save, objects, ALL) == sdo.HARDWARE_ERROR
    assert restored(memory).number(0x3000) == 77
    assert code_of(Store(None).save, objects, ALL) == sdo.CANNOT_STORE


def change_table(bank):
    """Make a bank one that was written with another table."""
    bank[8] ^= 1
    length = int.from_bytes(bytes(bank[12:16]), "little")
    crc = binascii.crc32(bytes(bank[:16]) + bytes(bank[20 : 20 + length]))
    bank[16:20] = crc.to_bytes(4, "little")


def test_settings_of_another_table_are_not_taken_but_the_node_id_is():
    memory = Memory()
    store = Store(memory)
    store.save_node_id(9)
    objects = defaults()
    objects.put(0x3000, 0, 77)
    store.save(objects, ALL)
    assert restored(memory).number(0x3000) == 77
    for bank in memory.banks:
        change_table(bank)
    assert restored(memory).number(0x3000) == 50
    assert Store(memory).node_id() == 9


def test_saved_entries_are_those_that_the_table_says():
    assert find(0x3000, 0).flags & record.STORED_APPLICATION
    assert not find(0x6040, 0).flags & ALL
