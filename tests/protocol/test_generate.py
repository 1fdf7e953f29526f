"""The generated files are current, and other people's tools read from them what we mean."""

import logging
import random
from pathlib import Path

import canopen
import cantools
import pytest
from canopen.objectdictionary import import_od

from mdms_protocol import cob, nmt, pdo
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.generators import generate

FOLDER = Path(__file__).parents[2] / "protocol"
NODE = 7


def test_generated_files_are_current():
    assert generate.stale() == []


def test_stale_file_is_named_and_written_anew(tmp_path, monkeypatch, capsys):
    path = tmp_path / "mdms-cell.eds"
    monkeypatch.setattr(generate, "outputs", lambda: {path: "new"})
    assert generate.main(["--check"]) == 1
    assert f"{path} is stale" in capsys.readouterr().err
    assert not path.exists()
    assert generate.main([]) == 0
    assert path.read_text() == "new"
    assert generate.main(["--check"]) == 0


@pytest.fixture
def dictionary(caplog):
    with caplog.at_level(logging.DEBUG):
        loaded = import_od(str(FOLDER / "mdms-cell.eds"), NODE)
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []
    return loaded


@pytest.fixture
def database(caplog):
    with caplog.at_level(logging.DEBUG):
        loaded = cantools.database.load_file(FOLDER / "mdms-cell.dbc", strict=True)
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []
    return loaded


def test_data_sheet_says_what_the_table_says(dictionary):
    for (index, sub), entry in ENTRIES.items():
        variable = dictionary.get_variable(index, sub)
        assert variable.name.endswith(entry.name)
        assert variable.data_type == entry.type.code
        assert variable.pdo_mappable == bool(entry.mappable)
        assert variable.writable == ("w" in entry.access)
        assert variable.readable == (entry.access != "wo")
        assert variable.factor == entry.unit.factor
        assert variable.unit == entry.unit.symbol
        if entry.type.size:
            assert variable.default == entry.default + (NODE if entry.from_node else 0)
        if (entry.low, entry.high) != (entry.type.low, entry.type.high):
            assert (variable.min, variable.max) == (entry.low, entry.high)


def recorded_log():
    """Frames of all default PDOs of three nodes, with the values they carry."""
    chance = random.Random(7)
    maps = (pdo.TARGET_VELOCITY, pdo.CONTROLWORD, pdo.ACTUAL_VELOCITY, pdo.STATUS)
    for _ in range(500):
        carried = chance.choice(maps)
        node_id = chance.choice((1, 7, 18))
        values = tuple(chance.randint(entry.low, entry.high) for entry in carried.entries)
        yield carried, node_id, values, carried.encode(values)


def test_database_decodes_a_bus_log_to_the_same_values(database):
    for carried, node_id, values, data in recorded_log():
        raw = database.decode_message(carried.can_id(node_id), data, scaling=False)
        assert tuple(raw.values()) == values
        scaled = database.decode_message(carried.can_id(node_id), data, decode_choices=False)
        for entry, value, physical in zip(carried.entries, values, scaled.values(), strict=True):
            assert physical == pytest.approx(value * entry.unit.factor)


def test_database_names_states(database):
    decoded = database.decode_message(cob.HEARTBEAT_BASE + 3, bytes((nmt.OPERATIONAL,)))
    assert str(decoded["state"]) == "operational"
    assert database.get_message_by_frame_id(cob.SYNC).length == 0


def test_data_sheet_decodes_a_bus_log_to_the_same_values(dictionary):
    bases = {0x200: ("rpdo", 1), 0x300: ("rpdo", 2), 0x180: ("tpdo", 1), 0x280: ("tpdo", 2)}
    node = canopen.Network().add_node(NODE, dictionary)
    node.rpdo.read(from_od=True)
    node.tpdo.read(from_od=True)
    for carried, _, values, data in recorded_log():
        direction, number = bases[carried.base]
        mapping = getattr(node, direction)[number]
        assert mapping.cob_id == carried.can_id(NODE)
        mapping.data = bytearray(data)
        assert tuple(variable.raw for variable in mapping) == values
