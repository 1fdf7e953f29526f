"""Other people's tools take the data sheet whole, and read the same values as in the table."""

import logging
import subprocess
import sys

import canopen
import dcf
import pytest
from canopen.objectdictionary import import_od
from eds_utils.core.file_io.read_eds import read_eds

from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.generators import eds

NODE = 7
MASTER = """\
master: {node_id: 127, baudrate: 1000, sync_period: 10000, heartbeat_producer: 100}
cell_1: {dcf: mdms-cell.eds, node_id: 1, heartbeat_consumer: true}
cell_2: {dcf: mdms-cell.eds, node_id: 2, revision_number: 0x00010000}
"""


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "mdms-cell.eds"
    path.write_text(eds.text())
    return path


@pytest.fixture
def dictionary(path, caplog):
    with caplog.at_level(logging.DEBUG):
        loaded = import_od(str(path), NODE)
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []
    return loaded


def units(dictionary):
    """Factor and unit by index and sub-index, from the comments of the data sheet."""
    found = {}
    for line in dictionary.comments.splitlines()[1:]:
        place, factor, unit = line.split(" ", 2)
        index, sub = place.split(":")
        found[int(index, 16), int(sub)] = float(factor), unit
    return found


def test_data_sheet_agrees_with_the_table(dictionary):
    for (index, sub), entry in ENTRIES.items():
        variable = dictionary.get_variable(index, sub)
        assert variable.name.endswith(entry.name)
        assert variable.data_type == entry.type.code
        assert variable.pdo_mappable == bool(entry.mappable)
        assert variable.writable == ("w" in entry.access)
        assert variable.readable == (entry.access != "wo")
        if entry.type.size:
            assert variable.default == entry.default + (NODE if entry.from_node else 0)
        if (entry.low, entry.high) != (entry.type.low, entry.type.high):
            assert (variable.min, variable.max) == (entry.low, entry.high)


def test_comments_of_the_data_sheet_give_the_units_of_the_table(dictionary):
    assert units(dictionary) == {
        place: (entry.unit.factor, entry.unit.symbol)
        for place, entry in ENTRIES.items()
        if entry.unit.symbol
    }


def test_lely_finds_nothing_to_warn_of(path):
    # Warnings are errors here.
    device = dcf.Device.from_dcf(str(path), env={"NODEID": NODE})
    assert [hex(pdo.cob_id) for pdo in device.rpdo.values()][:2] == ["0x207", "0x307"]


def test_lely_makes_a_master_of_it_without_being_lenient(path):
    (path.parent / "array.yml").write_text(MASTER)
    command = [sys.executable, "-m", "dcfgen.cli", "array.yml"]
    made = subprocess.run(command, cwd=path.parent, capture_output=True, text=True, check=False)
    assert (made.returncode, made.stderr) == (0, "")
    assert (path.parent / "master.dcf").stat().st_size > 0


def test_eds_utils_has_nothing_to_fix(path):
    _, errors = read_eds(str(path))
    assert errors == []


def test_data_sheet_decodes_a_bus_log_to_the_same_values(dictionary, recorded_log):
    bases = {0x200: ("rpdo", 1), 0x300: ("rpdo", 2), 0x180: ("tpdo", 1), 0x280: ("tpdo", 2)}
    node = canopen.Network().add_node(NODE, dictionary)
    node.rpdo.read(from_od=True)
    node.tpdo.read(from_od=True)
    for carried, _, values, data in recorded_log:
        direction, number = bases[carried.base]
        mapping = getattr(node, direction)[number]
        assert mapping.cob_id == carried.can_id(NODE)
        mapping.data = bytearray(data)
        assert tuple(variable.raw for variable in mapping) == values
