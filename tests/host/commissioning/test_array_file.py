import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.commissioning.array_file import ArrayFileError, array_text, filed_cells
from mdms_host.commissioning.cell_settings import CellSettings
from mdms_host.commissioning.parameters import BY_NAME, PARAMETERS


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
def test_what_is_written_is_read_back(tmp_path_factory, cell):
    (found,) = read(tmp_path_factory.mktemp("array"), array_text([cell]))
    assert (found.serial, found.node_id, found.values) == (cell.serial, 1, cell.values)


def test_values_stand_in_si_units():
    gain = BY_NAME["axis1.gain"]
    assert "settings.axis1.gain = 12.5  # V s/m" in array_text([CellSettings(1, 2, {gain: 12_500})])


CELL = '[[cell]]\nserial = "0000000A"\nnode = 1\n'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", r"array.toml: expected \[\[cell\]\] tables"),
        ("cell = 3", r"expected \[\[cell\]\]"),
        ("[[cell]]\nserial=\n", "array.toml: .*line 2"),
        ("[[cells]]\nnode = 1", "unknown key cells"),
        ("[[cell]]\nnode = 1", "cell.serial: expected 8 hex digits"),
        ('[[cell]]\nserial = "XY"\nnode = 1', "cell.serial: .*'XY'"),
        ('[[cell]]\nserial = "0A"\nnode = 128', "cell.node: expected 1 to 127, got 128"),
        (CELL + "colour = 1", "cell.colour: unknown key"),
        (CELL + "settings.axis3.gain = 1", "cell.settings.axis3.gain: there is no such setting"),
        (CELL + "settings.axis1 = 1", "cell.settings.axis1: there is no such setting"),
        (CELL + "settings = 1", "cell.settings: expected a table"),
        (CELL + "settings.axis1.gain = true", "expected a number, got True"),
        (CELL + "settings.axis1.gain = 1e3", "axis1.gain: 1000.0 is not in 0 to 100"),
        (CELL + CELL, "serial number 0000000A is there twice"),
        (CELL + CELL.replace("0A", "0B"), "node id 1 is there twice"),
    ],
)
def test_what_a_file_cannot_say_is_refused_with_its_place(tmp_path, text, told):
    with pytest.raises(ArrayFileError, match=told):
        read(tmp_path, text)


def test_missing_file_is_told(tmp_path):
    with pytest.raises(ArrayFileError, match=r"none.toml: No such file"):
        filed_cells(tmp_path / "none.toml")
