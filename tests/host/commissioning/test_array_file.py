import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.commissioning.array_file import (
    ArrayFileError,
    array_document,
    array_text,
    filed_cells,
    read_array,
)
from mdms_host.commissioning.cell_settings import CellSettings
from mdms_host.commissioning.parameters import BY_NAME, PARAMETERS
from mdms_model.scenario.scenario import Stop


def read(folder, text):
    path = folder / "array.toml"
    path.write_text(text)
    return filed_cells(path)


@st.composite
def cells(draw):
    values = {
        each: draw(st.integers(each.entry.low, each.entry.high))
        for each in draw(st.sets(st.sampled_from(PARAMETERS), max_size=5))
    }
    return CellSettings(1, draw(st.integers(0, 0xFFFFFFFF)), values)


@given(cell=cells())
def test_written_values_are_read_back(tmp_path_factory, cell):
    (found,) = read(tmp_path_factory.mktemp("array"), array_text({"can0": [cell]}))
    assert (found.serial, found.node_id, found.values) == (cell.serial, 1, cell.values)


def test_values_stand_in_si_units():
    gain = BY_NAME["axis1.gain"]
    assert "settings.axis1.gain = 12.5  # V s/m" in array_text(
        {"can0": [CellSettings(1, 2, {gain: 12_500})]}
    )


CELL = '[[cell]]\nserial = "0000000A"\nnode = 1\n'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", r"array.toml: expected \[\[cell\]\] tables"),
        ("cell = 3", r"expected \[\[cell\]\]"),
        ("[[cell]]\nserial=\n", "array.toml: .*line 2"),
        ("[[cells]]\nnode = 1", "unknown key cells"),
        ("[[cell]]\nnode = 1", "cell.0.serial: expected 8 hex digits"),
        ('[[cell]]\nserial = "XY"\nnode = 1', "cell.0.serial: .*'XY'"),
        ('[[cell]]\nserial = "0A"\nnode = 128', "cell.0.node: expected 1 to 127, got 128"),
        (CELL + '[[cell]]\nserial = "0B"\nnode = 128', "cell.1.node: expected 1 to 127, got 128"),
        (CELL + "colour = 1", "cell.0.colour: unknown key; known here: serial, node, bus, number"),
        (CELL + "settings.axis3.gain = 1", "cell.0.settings.axis3.gain: there is no such setting"),
        (
            CELL + "settings.axis1.polarty = 1",
            "cell.0.settings.axis1.polarty: .*; did you mean axis1.polarity",
        ),
        (CELL + "settings.axis1 = 1", "cell.0.settings.axis1: there is no such setting"),
        (CELL + "settings = 1", "cell.0.settings: expected a table"),
        (CELL + "settings.axis1.gain = true", "expected a number, got True"),
        (CELL + "settings.axis1.gain = 1e3", "cell.0.axis1.gain: 1000.0 is not in 0 to 100"),
        (CELL + CELL, "cell.1.serial: serial number 0000000A is that of cell.0 too"),
        (CELL + CELL.replace("0A", "0B"), "cell.1.node: node id 1 is that of cell.0 too"),
    ],
)
def test_a_bad_file_is_refused_with_the_place(tmp_path, text, told):
    with pytest.raises(ArrayFileError, match=told):
        read(tmp_path, text)


def test_missing_file_is_told(tmp_path):
    with pytest.raises(ArrayFileError, match=r"none.toml: cannot be read: No such file"):
        filed_cells(tmp_path / "none.toml")


ARRAY = """
[array]
columns = 2
rows = 1
pitch_m = 0.1
bitrate = 500000
sensor_offset_m = [[0.0, 0.0]]

[[array.wheel]]
direction_rad = 1.5
offset_m = [0.01, -0.02]
"""


def read_all(folder, text):
    path = folder / "array.toml"
    path.write_text(text)
    return read_array(path)


def test_table_is_read_beside_the_cells(tmp_path):
    table = read_all(tmp_path, ARRAY + CELL).table
    assert (table.columns, table.rows, table.pitch_m, table.bitrate) == (2, 1, 0.1, 500_000)
    assert [(wheel.direction_rad, wheel.offset_m) for wheel in table.wheel] == [
        (1.5, (0.01, -0.02))
    ]
    assert table.sensor_offset_m == ((0.0, 0.0),)


def test_file_of_cells_alone_leaves_the_table_open(tmp_path):
    table = read_all(tmp_path, CELL).table
    assert (table.columns, table.wheel, table.bitrate) == (None, None, None)


def test_table_without_cells_is_an_array_but_nothing_to_load(tmp_path):
    file = read_all(tmp_path, ARRAY)
    assert file.by_number(2, 1) == {}
    with pytest.raises(ArrayFileError, match=r"expected \[\[cell\]\]"):
        filed_cells(file.path)


def cell(serial, node, place=""):
    return f'[[cell]]\nserial = "{serial:08X}"\nnode = {node}\n{place}\n'


@pytest.mark.parametrize(
    "cells",
    [
        cell(1, 1) + cell(2, 2) + cell(3, 3) + cell(4, 4),
        cell(3, 30, "number = 3") + cell(4, 4) + cell(1, 1) + cell(2, 20, "number = 2"),
        cell(2, 9, "column = 2\nrow = 1")
        + cell(3, 8, "column = 1\nrow = 2")
        + cell(1, 1)
        + cell(4, 4),
    ],
)
def test_cells_stand_where_the_file_has_them(tmp_path, cells):
    placed = read_all(tmp_path, cells).by_number(2, 2)
    assert {number: each.serial for number, each in placed.items()} == {1: 1, 2: 2, 3: 3, 4: 4}


@pytest.mark.parametrize(
    ("cells", "told"),
    [
        (cell(1, 1) + cell(2, 5), r"cell.1.node: node 5 is beside the grid of 2 x 1"),
        (cell(1, 1, "number = 3"), r"cell.0.number: node 1 is beside the grid"),
        (cell(1, 1, "column = 3\nrow = 1"), r"cell.0.column: node 1 is beside the grid"),
        (cell(1, 1, "column = 1\nrow = 2"), r"cell.0.row: node 1 is beside the grid"),
        (cell(1, 1) + cell(2, 2, "number = 1"), r"node 2 and node 1 have the same place, number 1"),
        (cell(1, 1), r"cell: 1 of the 2 x 1 cells of the grid are listed; number 2 is missing"),
    ],
)
def test_cells_that_do_not_fill_the_grid_are_refused(tmp_path, cells, told):
    with pytest.raises(ArrayFileError, match=rf"array.toml: .*{told}"):
        read_all(tmp_path, cells).by_number(2, 1)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[array]\ncolumns = 0", "array.columns is 0, but must be at least 1"),
        ("[array]\npitch_m = 'x'", "array.pitch_m is 'x', but must be a number"),
        ("[array]\ncolums = 3", "array.colums is not a known key; did you mean columns"),
        ("[array]\nbitrate = 5", "array.bitrate is 5"),
        ("[[array]]\ncolumns = 3", "array is .*, but must be a table"),
        ("[[array.wheel]]\noffset_m = [1.0]", "array.wheel.0.offset_m has 1 items"),
        ("[array]\nwheel = []", "array.wheel has 0 items, but must have 1 to 2"),
        (CELL + "number = 0", "cell.0.number: expected a whole number from 1, got 0"),
        (CELL + "row = true", "cell.0.row: expected a whole number from 1, got True"),
        (CELL + "row = 1", "cell.0.row: a place is column and row, or number alone; got row"),
        (CELL + "number = 1\nrow = 1\ncolumn = 1", "cell.0.column: a place is"),
    ],
)
def test_a_bad_table_is_refused_with_its_key(tmp_path, text, told):
    with pytest.raises(ArrayFileError, match=rf"array.toml: {told}"):
        read_all(tmp_path, text)


TWO_BUSES = cell(1, 1, "number = 1") + cell(2, 1, "number = 2\nbus = 1")


def test_cells_of_two_buses_may_have_the_same_node_id(tmp_path):
    file = read_all(tmp_path, "[array]\nchannels = ['can0', 'can1']\n" + TWO_BUSES)
    assert [(each.bus, each.node_id) for each in file.cells] == [(0, 1), (1, 1)]
    assert file.bus_count == 2
    assert file.table.channels == ("can0", "can1")


def test_cells_of_several_buses_are_set_up_one_bus_after_the_other(tmp_path):
    file = read_all(tmp_path, "[array]\nchannels = ['can0', 'can1']\n" + TWO_BUSES)
    assert [each.serial for each in filed_cells(file.path, "can1")] == [2]
    with pytest.raises(ArrayFileError, match=r"on 2 buses.*is 'can2', but must be one of can0, ca"):
        filed_cells(file.path, "can2")
    file = read_all(tmp_path, TWO_BUSES)
    with pytest.raises(ArrayFileError, match=r"array.channels is to list them"):
        filed_cells(file.path, "can1")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (cell(1, 1, "bus = -1"), "cell.0.bus: expected 0 to 999, got -1"),
        (cell(1, 1, "bus = '0'"), "cell.0.bus: expected 0 to 999, got '0'"),
        (cell(1, 1, "bus = 1"), "cell.bus: there is a bus 1, but none on 0"),
        (
            TWO_BUSES + cell(3, 1, "number = 3\nbus = 1"),
            "cell.2.node: node id 1 on bus 1 is that of cell.. too",
        ),
        ("[array]\nchannels = ['a']\n" + TWO_BUSES, "array.channels has 1 items, but the cells"),
        ("[array]\nchannels = []\n", "array.channels has 0 items"),
    ],
)
def test_buses_of_a_file_that_do_not_fit_are_refused(tmp_path, text, told):
    with pytest.raises(ArrayFileError, match=rf"array.toml: {told}"):
        read_all(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('[stop]\nform = "relay"', "stop.form is 'relay', but must be one of short, category_1"),
        ('[stop]\nform = "short"\nmass_kg = 0', "stop.mass_kg is 0, but must be at least 1e-06"),
        ('[stop]\nform = "short"\nmass_kg = 2', "stop.speed_m_s is missing"),
    ],
)
def test_a_stop_that_cannot_be_is_refused_by_its_key(tmp_path, text, told):
    path = tmp_path / "array.toml"
    path.write_text(f"{text}\n[array]\ncolumns = 6\n")
    with pytest.raises(ArrayFileError, match=told):
        read_array(path)


def test_the_limits_of_the_stop_are_written_and_read_back(tmp_path):
    path = tmp_path / "array.toml"
    path.write_text('[array]\n[stop]\nform = "category_1"\nmass_kg = 2\nspeed_m_s = 0.4\n')
    file = read_array(path)
    path.write_text(array_document(file))
    assert read_array(path).stop == file.stop == Stop("category_1", 2.0, 0.4)


def test_cells_of_several_buses_are_written_with_their_channels_and_read_back(tmp_path):
    gain = BY_NAME["axis1.gain"]
    buses = {
        "a54.0": [CellSettings(1, 1, {gain: 12_500})],
        "a54.1": [CellSettings(1, 2, {gain: 13_000})],
    }
    path = tmp_path / "array.toml"
    path.write_text(array_text(buses))
    file = read_array(path)
    assert file.table.channels == ("a54.0", "a54.1")
    assert [(cell.serial, cell.node_id, cell.bus) for cell in file.cells] == [(1, 1, 0), (2, 1, 1)]


def test_a_place_is_asked_for_where_a_node_id_is_none(tmp_path):
    path = tmp_path / "array.toml"
    path.write_text(cell(1, 1, "number = 1") + cell(2, 1, "bus = 1"))
    with pytest.raises(ArrayFileError, match=r"cell\.1\.number is missing"):
        read_array(path).by_number(2, 1)
