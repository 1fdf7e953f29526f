import pytest

from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import ScenarioError

SMALL = ["array.columns=4", "array.rows=1", "parcel.0.goal={x_m=0.0, y_m=0.0}", "parcel.0.x_m=0.0"]


def load(*overrides):
    return load_scenario("array18", [*SMALL, *overrides])


def test_lists_of_cells_are_read():
    assert load("array.buses=[[1, 2], [4, 3]]").array.buses == ((1, 2), (4, 3))
    assert load().array.buses == ()


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["array.buses=[[1, 2], [3, 5]]"], r"array.buses.1.1 is 5, but the array has 4 cells"),
        (["array.buses=[[1, 2], [3, 0]]"], r"array.buses.1.1 is 0, but must be at least 1"),
        (["array.buses=[[1, 2, 3], [3, 4]]"], r"array.buses.1.0 is 3, but cell 3 is in array.bus"),
        (["array.buses=[[1, 2], [3]]"], r"array.buses lacks cell 4"),
        (
            ["array.buses=[[1, 2], [], [3, 4]]"],
            r"array.buses.1 has 0 items, but must have 1",
        ),
        (["array.buses=[1, 2]"], r"array.buses.0 is 1, but must be a list"),
        (["array.forwarded=[1]"], r"array.forwarded needs several buses"),
        (
            ["array.buses=[[1, 2], [3, 4]]", "array.forwarded=[5]"],
            r"array.forwarded.0 is 5, but must be at least 1 and at most 4",
        ),
        (["array.columns=127"], r"array has 127 x 1 cells, but one bus takes at most 126"),
        (['fault=[{kind="loss", bus=1}]'], r"fault.0.bus has 1, but buses are numbered 0 to 0"),
        (
            ["array.buses=[[1, 2], [3, 4]]", 'fault=[{kind="off", cells=[1], bus=1}]'],
            r"fault.0.bus is 1, but 'off' is of cells or parcels",
        ),
    ],
)
def test_buses_that_do_not_fit_are_refused_with_their_key(overrides, told):
    with pytest.raises(ScenarioError, match=told):
        load(*overrides)


def test_more_cells_than_one_bus_takes_may_be_on_several():
    halves = [list(range(1, 101)), list(range(101, 201))]
    assert load("array.columns=200", f"array.buses={halves}").array.columns == 200


def test_cells_around_a_bus_must_find_node_ids_on_it():
    # A bus of 60 cells in every second column, and so 120 or more of others around it.
    own = [number for number in range(1, 361) if number % 2 == 0 and number > 240]
    others = [number for number in range(1, 361) if number not in own]
    lists = [own, others[:120], others[120:200], others[200:]]
    with pytest.raises(ScenarioError, match=r"array.forwarded: bus 0 has node ids up to 60"):
        load("array.columns=120", "array.rows=3", f"array.buses={lists}", "array.forwarded=[1]")
