"""Plans in a record file, and parcels that come and go in its scene."""

from dataclasses import replace

import numpy as np

from mdms_model.run.mcap_file import read_record, write_record
from mdms_model.run.record import Plan, Tile
from mdms_model.run.scene_3d import scene_messages


def test_plans_are_written_and_read_again(tmp_path, plane, plane_record):
    way = np.array([[0.0, 0.1, 0.2], [0.3, 0.1, 0.2]])
    tiles = (Tile(0.1, -0.1, 0.03, ("box", "disc")), Tile(0.2, -0.1, 0.03, ("disc",)))
    plans = [Plan(0.5, {"box": way}, tiles), Plan(1.5, {})]
    write_record(tmp_path / "run.mcap", plane, replace(plane_record, plans=plans))
    first, second = read_record(tmp_path / "run.mcap", plane).plans
    np.testing.assert_array_equal(first.ways["box"], way)
    assert (first.time_s, first.tiles) == (0.5, tiles)
    assert (second.time_s, dict(second.ways), second.tiles) == (1.5, {}, ())


def test_a_record_without_plans_has_none(tmp_path, plane, plane_record):
    write_record(tmp_path / "run.mcap", plane, plane_record)
    assert read_record(tmp_path / "run.mcap", plane).plans == []


def test_a_parcel_that_leaves_is_taken_out_of_the_scene(plane, plane_record):
    pose = plane_record.pose.copy()
    pose[:10] = pose[20:30] = np.nan
    messages = list(scene_messages(plane, replace(plane_record, pose=pose)))
    there = [any(entity["id"] == "box" for entity in each["entities"]) for _, each in messages]
    gone = [each["deletions"] for _, each in messages if each["deletions"]]
    assert [each for each, before in zip(there[1:], there, strict=False) if each != before] == [
        True,
        False,
        True,
    ]
    assert [[deletion["id"] for deletion in each] for each in gone] == [["box"]]
