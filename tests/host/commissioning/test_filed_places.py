import pytest

from mdms_host.commissioning.array_file import ArrayFileError, placed_cells, read_array
from mdms_host.commissioning.parameters import BY_NAME
from mdms_host.layout import Layout
from mdms_host.places import place_values
from mdms_protocol import indices

TABLE = "[array]\ncolumns = 3\nrows = 2\npitch_m = 0.1\n"
WHEELS = """
[[array.wheel]]
direction_rad = 0.5
offset_m = [-0.02, 0.001]
[[array.wheel]]
direction_rad = 1.5
offset_m = [0.02, 0.0]
"""
DIRECTIONS = (
    *("east", "north_east", "north", "north_west"),
    *("west", "south_west", "south", "south_east"),
)


def cells(*lines):
    """Node ids 11 to 16 at 1 to 6; some with lines of their own."""
    more = dict(lines)
    return "".join(
        f'\n[[cell]]\nserial = "{number:08X}"\nnode = {10 + number}\nnumber = {number}\n'
        + more.get(number, "")
        for number in range(1, 7)
    )


@pytest.fixture
def placed(tmp_path):
    def read(text):
        path = tmp_path / "array.toml"
        path.write_text(text)
        return {
            cell.node_id: {each.name: each.si(number) for each, number in cell.values.items()}
            for cell in placed_cells(read_array(path))
        }

    return read


def neighbours(values):
    return [values[f"neighbour_{direction}"] for direction in DIRECTIONS]


def test_cells_get_place_and_neighbours_from_the_grid(placed):
    found = placed(TABLE + cells())
    middle = found[12]
    assert [middle[f"place_{key}"] for key in ("column", "row", "x", "y", "pitch")] == [
        *(2, 1, 0.0, -0.05, 0.1)
    ]
    assert neighbours(middle) == [13, 16, 15, 14, 11, 0, 0, 0]
    assert neighbours(found[16]) == [0, 0, 0, 0, 15, 12, 13, 0]
    assert [found[node]["sync_takeover_rank"] for node in sorted(found)] == [1, 2, 3, 4, 5, 6]
    assert "axis1.contact_x" not in middle
    assert "presence_sensor_1_x" not in middle


def test_wheels_and_sensors_are_written_where_the_table_has_them(placed):
    sensors = "sensor_offset_m = [[0.0, 0.0], [0.01, -0.02]]\n"
    own = (5, "settings.axis1.contact_x = -0.025\n")
    found = placed(TABLE + sensors + WHEELS + cells(own))
    wheel = [found[11][f"axis1.{key}"] for key in ("contact_x", "contact_y", "direction")]
    assert wheel == [-0.02, 0.001, 0.5]
    assert found[11]["presence_sensor_2_y"] == -0.02
    assert found[15]["axis1.contact_x"] == -0.025


def test_place_of_a_cell_is_the_tables_whatever_was_dumped(placed):
    stale = (1, "settings.place_column = 3\nsettings.place_row = 0\nsettings.control = 1\n")
    found = placed(TABLE + cells(stale))
    assert (found[11]["place_column"], found[11]["place_row"]) == (1, 1)
    assert found[11]["control"] == 1


def test_file_without_a_grid_says_nothing_of_places(placed):
    own = (1, "settings.place_column = 3\n")
    assert placed(cells(own))[11] == {"place_column": 3}
    assert placed(cells(own))[12] == {}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (TABLE.replace("0.1", "3.0") + cells(), "array: .*pitch: 3000000 is not in 1000..1000000"),
        (TABLE.replace("rows = 2", "rows = 3") + cells(), "number 7 is missing"),
    ],
)
def test_table_that_does_not_fit_the_cells_is_refused(placed, text, told):
    with pytest.raises(ArrayFileError, match=told):
        placed(text)


def test_names_of_places_are_those_of_the_object_table():
    assert {f"neighbour_{direction}" for direction in DIRECTIONS} <= BY_NAME.keys()


def test_turns_to_take_over_sync_are_counted_on_each_bus():
    layout = Layout(4, 1, node_ids=(5, 6, 1, 2), buses=(0, 0, 1, 1))
    ranks = [place_values(layout, number)[indices.LEASE, 4] for number in range(1, 5)]
    assert ranks == [1, 2, 1, 2]
