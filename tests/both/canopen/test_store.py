"""Saved settings: the values that come back, and a power failure at any byte of a save."""

import struct

from refusal import code_of

from mdms_cell.canopen.objects import Objects, find
from mdms_cell.canopen.store import Store, write_bank
from mdms_protocol import record
from mdms_protocol.codecs import sdo

SIZE = 96
ALL = record.STORED_COMMUNICATION | record.STORED_APPLICATION


class PowerLost(Exception):  # noqa: N818 - an event of the test
    """The supply has failed."""


class Memory:
    """Two banks; after `budget` more bytes the supply fails, in the middle of a write."""

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


def test_saved_settings_come_back():
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
    store.drop(record.STORED_APPLICATION)
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
        memory, objects, _ = saved()
        store = Store(memory)
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
    for place in range(22):
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


#: Codes of data types (CiA 301, table 44).
U8, U16, I32, U32 = 5, 6, 4, 7
SIZES = {U8: 1, U16: 2, I32: 4, U32: 4}
NODE_ID_9 = (0, 0, U8, 9)


def written_by_another_firmware(*items):
    """A memory that holds these values, each as (index, sub-index, type, number)."""
    memory = Memory()
    values = b""
    for index, sub, type_, number in items:
        size = SIZES[type_]
        head = struct.pack("<HBB", index, sub, type_ << 4 | size)
        values += head + number.to_bytes(size, "little")
    write_bank(memory, 0, 1, values)
    return memory


def test_settings_survive_a_firmware_that_has_other_objects_besides():
    memory = written_by_another_firmware(
        NODE_ID_9, (0x1017, 0, U16, 250), (0x2FFF, 0, U32, 1), (0x3000, 0, U16, 77)
    )
    objects = defaults()
    assert Store(memory).restore(objects, ALL) == [(0x2FFF, 0)]
    assert (objects.number(0x1017), objects.number(0x3000)) == (250, 77)
    assert Store(memory).node_id() == 9


def test_value_of_another_type_or_of_no_setting_is_not_taken_and_reported():
    misfits = (
        (0x3000, 0, U32, 77),
        (0x2000, 0, I32, 77),
        (0x1018, 9, U32, 77),
        (0x6040, 0, U16, 77),
        (0x1008, 0, U32, 77),
    )
    memory = written_by_another_firmware(NODE_ID_9, *misfits, (0x1017, 0, U16, 250))
    objects = defaults()
    assert Store(memory).restore(objects, ALL) == [each[:2] for each in misfits]
    expected = defaults()
    expected.put(0x1017, 0, 250)
    assert objects.data == expected.data


def test_value_out_of_the_limits_of_today_gives_way_to_the_default():
    memory = written_by_another_firmware((0x3000, 0, U16, 60_000), (0x2009, 0, I32, 3_141_594))
    objects = defaults()
    assert Store(memory).restore(objects, ALL) == [(0x3000, 0), (0x2009, 0)]
    assert objects.number(0x3000) == 50


def test_saved_pdo_that_no_client_could_make_gives_way_to_its_default():
    sound = (0x1A01, 1, U32, 0x30010008), (0x1A01, 0, U8, 1)
    for unsound in (
        ((0x1A00, 1, U32, 0x2FFF0020),),  # an object that is not there
        ((0x1A00, 1, U32, 0x30000010),),  # one that no PDO carries
        ((0x1800, 1, U32, 0x185),),  # a promise to answer remote requests
        ((0x1800, 1, U32, 0x40000605),),  # the identifier of a service
        ((0x1800, 2, U8, 245),),
        ((0x1A00, 0, U8, 3), (0x1A00, 3, U32, 0x606C0020)),  # more than 64 bits
    ):
        memory = written_by_another_firmware(*sound, *unsound)
        objects = defaults()
        assert Store(memory).restore(objects, ALL) == [(0x1800, 1)]
        expected = defaults()
        expected.put(0x1A01, 0, 1)
        expected.put(0x1A01, 1, 0x30010008)
        assert objects.data == expected.data, unsound


def test_saved_identifiers_of_sync_and_emergencies_are_checked_too():
    memory = written_by_another_firmware((0x1005, 0, U32, 0x601), (0x1014, 0, U32, 0x20000085))
    objects = defaults()
    assert Store(memory).restore(objects, ALL) == [(0x1005, 0), (0x1014, 0)]
    assert objects.data == defaults().data


def test_unknown_values_wait_for_their_firmware_until_the_next_save():
    memory = written_by_another_firmware(NODE_ID_9, (0x2FFF, 0, U32, 1), (0x3000, 0, U16, 77))
    store = Store(memory)
    store.save_node_id(8)
    assert Store(memory).restore(defaults(), ALL) == [(0x2FFF, 0)]
    store.drop(record.STORED_COMMUNICATION)
    objects = defaults()
    assert Store(memory).restore(objects, ALL) == []
    assert objects.number(0x3000) == 77
    assert Store(memory).node_id() == 8


def test_node_id_that_cannot_be_one_does_not_count():
    for number, taken in ((0, None), (1, 1), (127, 127), (128, None), (254, None), (255, 255)):
        assert Store(written_by_another_firmware((0, 0, U8, number))).node_id() == taken


def test_saved_entries_are_those_that_the_table_says():
    assert find(0x3000, 0).flags & record.STORED_APPLICATION
    assert not find(0x6040, 0).flags & ALL
