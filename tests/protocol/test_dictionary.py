from mdms_protocol import entry as e
from mdms_protocol.dictionary import AXIS_OFFSET, ENTRIES, OBJECTS, RPDO_MAPS, TPDO_MAPS


def test_objects_are_in_order_and_entries_count_themselves():
    indices = [each.index for each in OBJECTS]
    assert indices == sorted(set(indices))
    for each in OBJECTS:
        subs = [entry.sub for entry in each.entries]
        assert subs == sorted(subs)
        if each.kind != e.VARIABLE and each.entries[0].access == e.CONST:
            assert each.entries[0].default == max(subs)


def test_defaults_lie_within_limits_and_limits_within_the_type():
    for entry in ENTRIES.values():
        if entry.type not in (e.TEXT, e.DOMAIN):
            assert entry.type.low <= entry.low <= entry.high <= entry.type.high, entry
            assert entry.type.low <= entry.default <= entry.type.high, entry
        if entry.stored:
            assert entry.access == e.READ_WRITE, entry
            assert entry.from_node or entry.low <= entry.default <= entry.high, entry


def test_axis_2_has_the_objects_of_axis_1():
    for (index, sub), entry in ENTRIES.items():
        if 0x2000 <= index < 0x2800 or 0x6000 <= index < 0x6800:
            other = ENTRIES[index + AXIS_OFFSET, sub]
            assert other.name == entry.name.replace("Axis 1", "Axis 2")
            assert (other.type, other.access, other.low, other.high) == (
                entry.type,
                entry.access,
                entry.low,
                entry.high,
            )


def test_steps_of_a_unit_are_whole_and_undo_its_factor():
    for entry in ENTRIES.values():
        assert 1 / e.steps_per_unit(entry.unit) == entry.unit.factor
    assert e.steps_per_unit(e.MICROMETRES_PER_SECOND) == 1_000_000


def test_default_maps_carry_mappable_objects_and_fit():
    for maps, direction in ((RPDO_MAPS, e.RPDO), (TPDO_MAPS, e.TPDO)):
        for items in maps:
            for item in items:
                entry = ENTRIES[item >> 16, item >> 8 & 0xFF]
                assert entry.mappable & direction
                assert entry.type.size * 8 == item & 0xFF
            assert sum(item & 0xFF for item in items) <= 64
