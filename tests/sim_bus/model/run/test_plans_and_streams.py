"""Plans in a record file."""

import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from mdms_model.run.mcap_file import read_record, write_record
from mdms_model.run.record import Plan, Tile


def test_plans_are_written_and_read_again(tmp_path, plane, plane_record):
    way = np.array([[0.0, 0.1, 0.2], [0.3, 0.1, 0.2]])
    tiles = (Tile(0.1, -0.1, 0.03, ("box", "disc")), Tile(0.2, -0.1, 0.03, ("disc",)))
    goals = {"box": way[1], "disc": np.array([0.1, 0.2, np.nan])}
    plans = [
        Plan(0.5, {"box": way}, tiles, {"box": np.array([0.5, 1.7])}, goals),
        Plan(1.5, {}),
    ]
    write_record(tmp_path / "run.mcap", plane, replace(plane_record, plans=plans))
    first, second = read_record(tmp_path / "run.mcap", plane).plans
    np.testing.assert_array_equal(first.ways["box"], way)
    np.testing.assert_array_equal(first.due_s["box"], [0.5, 1.7])
    np.testing.assert_array_equal(first.goals["disc"], goals["disc"])
    assert (first.time_s, first.tiles) == (0.5, tiles)
    assert (second.time_s, dict(second.ways), second.tiles) == (1.5, {}, ())


def test_a_record_without_plans_has_none(tmp_path, plane, plane_record):
    write_record(tmp_path / "run.mcap", plane, plane_record)
    assert read_record(tmp_path / "run.mcap", plane).plans == []


def test_each_goal_is_a_command_once_when_it_is_given(tmp_path, plane, plane_record):
    east, north = np.array([0.3, 0.1, 0.2]), np.array([0.0, 0.2, np.nan])
    goals = [{"box": east}, {"box": east}, {"box": north}, {}, {"box": north}]
    plans = [Plan(number + 0.5, {}, goals=each) for number, each in enumerate(goals)]
    write_record(tmp_path / "run.mcap", plane, replace(plane_record, plans=plans))
    with (tmp_path / "run.mcap").open("rb") as stream:
        found = [m.data for _, _, m in make_reader(stream).iter_messages(topics=["/commands"])]
    assert [json.loads(data) for data in found] == [
        {"time_s": 0.5, "parcel": "box", "x_m": 0.3, "y_m": 0.1, "yaw_rad": 0.2},
        {"time_s": 2.5, "parcel": "box", "x_m": 0.0, "y_m": 0.2},
        {"time_s": 4.5, "parcel": "box", "x_m": 0.0, "y_m": 0.2},
    ]


def test_a_parcels_goal_stands_beside_its_pose_for_as_long_as_it_has_it(
    tmp_path, plane, plane_record
):
    plans = [Plan(1.0, {}, goals={"box": np.array([0.3, 0.1, 0.2])}), Plan(2.0, {})]
    write_record(tmp_path / "run.mcap", plane, replace(plane_record, plans=plans))
    with (tmp_path / "run.mcap").open("rb") as stream:
        rows = [
            json.loads(m.data)
            for _, _, m in make_reader(stream).iter_messages(topics=["/parcel/box"])
        ]
    assert [row["time_s"] for row in rows if "goal" in row] == [
        time_s for time_s in plane_record.time_s if 1.0 <= time_s < 2.0
    ]


def test_how_far_the_belief_is_off_is_there_in_millimetres_and_degrees(
    tmp_path, plane, plane_record
):
    write_record(tmp_path / "run.mcap", plane, plane_record)
    with (tmp_path / "run.mcap").open("rb") as stream:
        rows = [
            json.loads(m.data)
            for _, _, m in make_reader(stream).iter_messages(topics=["/parcel/box"])
        ]
    assert "estimate_off" not in rows[4]
    assert rows[5]["estimate_off"]["place_mm"] == pytest.approx(2**0.5)
    assert rows[5]["estimate_off"]["yaw_deg"] == pytest.approx(np.degrees(0.001))
