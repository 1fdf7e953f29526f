"""Parcels that come and leave are counted, drawn at their places, and keep their names."""

import numpy as np
import pytest
from tests.host.page.bench import Desk

from mdms_array.host import parcels_of
from mdms_host.page import commands
from mdms_host.page.description import PARCEL_STATES
from mdms_host.page.flow import FlowCount, beside, ends_of
from mdms_model.run.record import Event, leaving
from mdms_model.scenario.file import load_scenario

SORT = load_scenario("sort54")
ENDS = ends_of(SORT, parcels_of(SORT))


def pose(x_m, y_m):
    return np.array([x_m, y_m, 0.0])


def test_ends_lie_at_the_edge_of_the_table():
    described = ENDS.describe()
    (infeed,) = described["infeeds"]
    stream = SORT.stream[0]
    assert (infeed["x_m"], infeed["y_m"]) == (stream.x_m, stream.y_m)
    assert len(infeed["outline_m"]) == 4
    half_x_m, half_y_m = 9 * 0.127 / 2, 6 * 0.127 / 2
    exits = {each["name"]: each for each in described["exits"]}
    assert exits["east"]["ends_m"] == [
        [pytest.approx(half_x_m), pytest.approx(-half_y_m)],
        [pytest.approx(half_x_m), pytest.approx(half_y_m)],
    ]
    assert exits["south"]["out"] == [0.0, -1.0]
    assert [y for _, y in exits["south"]["ends_m"]] == pytest.approx([-half_y_m] * 2)
    assert set(described["stock"]) == {parcel.name for parcel in SORT.parcel}


def test_parcels_are_counted_by_exit_once_each():
    count = FlowCount(ENDS)
    events = [
        Event(1.0, "arrival", "set down", parcel="small 1"),
        Event(2.0, "touch", "touches", parcel="small 1"),
        leaving(3.0, "small 1", "north", wrong=False),
    ]
    count.count(events)
    events += [
        Event(4.0, "arrival", "set down", parcel="small 1"),
        leaving(5.0, "small 1", "east", wrong=True),
    ]
    count.count(events)
    values = count.values(10.0)
    assert values["parcels_came"] == [2]
    names = [each["name"] for each in ENDS.exits]
    assert dict(zip(names, values["parcels_left"], strict=True)) == {
        "north": 1,
        "east": 1,
        "south": 0,
    }
    assert values["flow_time"] == [pytest.approx(10.0 - SORT.stream[0].start_s)]


def test_table_without_infeed_and_exit_has_no_counts():
    plain = load_scenario("array18")
    assert FlowCount(ends_of(plain, parcels_of(plain))).values(1.0) == {}


def test_like_parcels_keep_the_names_of_beliefs_beside_the_truth():
    """The host has called the first small one 'small 2', and the second 'small 1'."""
    believed = {"small 2": pose(0.1, 0.0), "small 1": pose(-0.3, 0.0), "disc 1": pose(0.0, 0.2)}
    true = {"small 1": pose(0.11, 0.0), "small 3": pose(-0.31, 0.0), "disc 1": pose(0.4, 0.2)}
    named = beside(believed, true, ENDS)
    assert named["small 2"] is true["small 1"]
    assert named["small 1"] is true["small 3"]
    assert named["disc 1"] is true["disc 1"]
    assert len(named) == 3


def test_truth_that_nobody_believes_has_a_name_that_is_free():
    believed = {"small 1": pose(0.1, 0.0)}
    true = {"small 1": pose(-0.3, 0.0), "small 2": pose(0.11, 0.0)}
    named = beside(believed, true, ENDS)
    assert named["small 1"] is true["small 2"]
    assert named["small 2"] is true["small 1"]


def test_stream_is_shown_with_its_stock_and_its_counts(monkeypatch):
    desk = Desk(monkeypatch, SORT)
    desk.run(0.1)
    assert {PARCEL_STATES[k] for k in desk.shown["parcel_state"]} == {"in stock"}
    assert desk.shown["parcels_came"][0] <= 1
    desk.table.do(commands.Start())
    desk.run_until(lambda: desk.shown["parcels_came"][0] == 2, 8.0)
    shown = desk.shown
    assert list(shown["parcel_state"]).count(PARCEL_STATES.index("found")) in (1, 2)
    assert shown["parcels_left"].shape == (3,)
    there = np.isfinite(shown["parcel_true"][:, 0])
    assert 1 <= there.sum() <= 2
