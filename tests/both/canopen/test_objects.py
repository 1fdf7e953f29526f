"""The packed dictionary of a cell agrees with the object table, entry by entry."""

from mdms_cell.canopen.objects import Objects, find
from mdms_protocol import record
from mdms_protocol.codecs import sdo
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import TEXT


def refusal(index, sub):
    try:
        find(index, sub)
    except sdo.AbortError as error:
        return error.code
    return None


def test_every_entry_is_found_with_its_type_and_size():
    for (index, sub), entry in ENTRIES.items():
        found = find(index, sub)
        assert (found.index, found.sub, found.type) == (index, sub, entry.type.code)
        size = len(entry.default) if entry.type == TEXT else entry.type.size
        assert found.size == size, (index, sub)


def test_entries_lie_one_after_the_other():
    end = 0
    for index, sub in sorted(ENTRIES):
        found = find(index, sub)
        assert found.place == end
        end += found.size
    assert end == len(Objects().data)


def test_limits_are_those_of_the_table():
    for (index, sub), entry in ENTRIES.items():
        if entry.type.size and (entry.low, entry.high) != (entry.type.low, entry.type.high):
            found = find(index, sub)
            found.check(entry.low)
            found.check(entry.high)
            for wrong in (entry.low - 1, entry.high + 1):
                try:
                    found.check(wrong)
                except sdo.AbortError:
                    continue
                raise AssertionError((index, sub, wrong))


def test_an_object_beyond_the_table_is_not_found():
    indices = {index for index, _ in ENTRIES}
    for index in sorted(indices):
        for sub in range(12):
            missing = (index, sub) not in ENTRIES
            assert refusal(index, sub) == (sdo.NO_SUCH_SUB_INDEX if missing else None)
        if index + 1 not in indices:
            assert refusal(index + 1, 0) == sdo.NO_SUCH_OBJECT
    for index in (0, 0x0FFF, 0xFFFF):
        assert refusal(index, 0) == sdo.NO_SUCH_OBJECT
    assert refusal(0x1018, 0xFF) == sdo.NO_SUCH_SUB_INDEX


def test_defaults_are_those_of_the_table():
    objects = Objects()
    objects.reset(5, record.FROM_NODE)
    for (index, sub), entry in ENTRIES.items():
        if entry.type.size:
            expected = entry.default + (5 if entry.from_node else 0)
            assert objects.number(index, sub) == expected, (index, sub)
