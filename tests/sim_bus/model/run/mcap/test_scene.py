"""A run in 3D: every message of a topic is the whole of it, so that a seek finds all there is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from mdms_model.run.mcap_file import write_record
from mdms_model.run.mcap_scene import AGAIN_S, layers, scene_messages
from mdms_model.run.record import Plan, Tile
from mdms_model.scenario.scenario import Exit


def messages(scenario, record, topic):
    """Times and the parts of the only entity."""
    (layer,) = (each for each in layers(scenario, record) if each.topic == topic)
    found = list(scene_messages(layer, record))
    for _, message in found:
        assert message["deletions"] == []
        assert [each["lifetime"] for each in message["entities"]] == [{"sec": 0, "nsec": 0}]
    return [(time_s, message["entities"][0]) for time_s, message in found]


def test_seek_to_any_time_finds_table_wheels_goal_and_parcel(tmp_path, plane, plane_record):
    write_record(tmp_path / "run.mcap", plane, plane_record)
    wanted = {"/scene/table": 1 + 18 * 6, "/scene/wheels": 36, "/scene/parcels": 1}
    for seek_s in (0.0, 0.9, 2.55, 4.0):
        with (tmp_path / "run.mcap").open("rb") as stream:
            last = {
                channel.topic: (json.loads(message.data), schema.name)
                for schema, channel, message in make_reader(stream).iter_messages()
                if message.log_time <= round(seek_s * 1e9)
            }
        for topic, count in wanted.items():
            scene, schema = last[topic]
            (entity,) = scene["entities"]
            assert schema == "foxglove.SceneUpdate"
            assert len(entity["cubes"]) == count, topic
        assert len(last["/scene/goals"][0]["entities"][0]["lines"]) == 3


def test_an_unchanged_topic_comes_again_every_second(plane, plane_record):
    times_s = [time_s for time_s, _ in messages(plane, plane_record, "/scene/table")]
    assert times_s == pytest.approx(np.arange(0.0, 4.1, AGAIN_S))


def test_exits_are_named_along_their_stretches_of_the_edge(plane, plane_record):
    doors = Exit("north", "north", from_m=-0.1, to_m=0.2), Exit("west", "west")
    _, table = messages(replace(plane, exit=doors), plane_record, "/scene/table")[0]
    ends = [[(point["x"], point["y"]) for point in each["points"]] for each in table["lines"]]
    assert ends == [[(-0.1, 0.1905), (0.2, 0.1905)], [(-0.381, -0.1905), (-0.381, 0.1905)]]
    assert [each["text"] for each in table["texts"]][-2:] == ["north", "west"]


def test_parcel_is_where_it_is_and_named(plane, plane_record):
    time_s, entity = messages(plane, plane_record, "/scene/parcels")[-1]
    (body,) = entity["cubes"]
    x_m, y_m, yaw_rad = plane_record.pose[round(time_s * 10), 0]
    assert (body["pose"]["position"]["x"], body["pose"]["position"]["y"]) == (x_m, y_m)
    turn = body["pose"]["orientation"]
    assert 2 * np.arctan2(turn["z"], turn["w"]) == pytest.approx(yaw_rad)
    assert [each["text"] for each in entity["texts"]] == ["box"]


def test_belief_is_a_ghost_once_there_is_one(plane, plane_record):
    found = messages(plane, plane_record, "/scene/beliefs")
    bodies = {round(time_s, 1): len(entity["cubes"]) for time_s, entity in found}
    assert (bodies[0.0], bodies[0.5]) == (0, 1)
    (ghost,) = found[-1][1]["cubes"]
    assert ghost["color"]["a"] < 0.3
    assert len(found[-1][1]["lines"]) == 1


def test_on_hardware_there_are_ghosts_alone(plane, believed_record):
    topics = {layer.topic for layer in layers(plane, believed_record)}
    assert "/scene/beliefs" in topics
    assert "/scene/parcels" not in topics


def test_a_parcel_that_leaves_is_taken_out_of_the_scene(plane, plane_record):
    pose = plane_record.pose.copy()
    pose[:10] = pose[20:30] = np.nan
    found = messages(plane, replace(plane_record, pose=pose), "/scene/parcels")
    there = [len(entity["cubes"]) for _, entity in found]
    assert [each for each, before in zip(there[1:], there, strict=False) if each != before] == [
        *(1, 0, 1),
    ]


def test_wheel_has_a_colour_by_its_speed_and_another_when_it_slips(plane, plane_record):
    still = np.zeros_like(plane_record.speed_m_s)
    slip, speed = still.copy(), still.copy()
    speed[:, 1], speed[:, 2], speed[:, 3] = 0.3, 0.1, -0.3
    slip[20:, 1] = 0.01
    record = replace(plane_record, speed_m_s=speed, slip_m_s=slip)
    found = messages(plane, record, "/scene/wheels")
    first, last = ([cube["color"] for cube in found[place][1]["cubes"]] for place in (0, -1))
    assert first[0] == first[4]
    assert len({tuple(colour.values()) for colour in first[:4]}) == 4
    assert last[1] != first[1]
    assert last[1]["r"] > last[1]["b"]
    assert (last[0], *last[2:]) == (first[0], *first[2:])


def test_covered_sensors_are_dots(plane, plane_record):
    presence = np.zeros((len(plane_record.time_s), 18), np.uint8)
    presence[10:, 4] = 0b10001
    found = messages(plane, replace(plane_record, presence=presence), "/scene/presence")
    dots = [
        [(cube["pose"]["position"]["x"], cube["pose"]["position"]["y"]) for cube in each["cubes"]]
        for _, each in (found[0], found[-1])
    ]
    # Cell 5 is the fifth of the lowest row of 6 x 3.
    middle = (1.5 * 0.127, -0.127)
    corner = (middle[0] + 0.03175, middle[1] - 0.03175)
    assert dots[0] == []
    np.testing.assert_allclose(dots[1], [middle, corner], atol=1e-5)


def test_ways_and_tiles_are_those_of_the_plan_in_effect(plane, plane_record):
    way = np.array([[0.0, 0.1, 0.2], [0.3, 0.1, 0.2]])
    plans = [
        Plan(0.5, {"box": way}, (Tile(0.1, -0.1, 0.03, ("box",)),)),
        Plan(1.55, {}),
    ]
    found = messages(plane, replace(plane_record, plans=plans), "/scene/plans")
    shown = {
        round(time_s, 1): (len(entity["lines"]), len(entity["cubes"])) for time_s, entity in found
    }
    assert shown == {
        **{0.0: (0, 0), 0.5: (1, 1), 1.5: (1, 1), 1.6: (0, 0)},
        **{2.6: (0, 0), 3.6: (0, 0)},
    }


def test_scene_has_no_more_pictures_than_eyes_need(plane, plane_record):
    many_s = np.linspace(0, 4, 4001)
    poses = np.zeros((4001, 1, 3))
    poses[:, 0, 0] = many_s
    numbers = np.zeros((4001, 36))
    names = ("reference_m_s", "speed_m_s", "voltage_v", "normal_n", "force_n")
    dense = replace(
        plane_record,
        **{"time_s": many_s, "pose": poses, "estimate": None, "contact": numbers.astype(np.int8)},
        **dict.fromkeys(names, numbers),
    )
    times_s = [time_s for time_s, _ in messages(plane, dense, "/scene/parcels")]
    assert 110 < len(times_s) <= 121
    assert min(np.diff(times_s)) >= 1 / 30 - 1e-6


def test_scene_gives_a_disc_and_a_polygon_their_bodies(plane, plane_record):
    box = replace(plane.parcel[0], length_m=0.3, width_m=0.3)
    corners = ((-0.1, -0.1), (0.15, 0.0), (-0.1, 0.1))
    for shape, kind in ((replace(box, shape="disc"), "cylinders"), (None, "triangles")):
        parcel = shape or replace(box, shape="polygon", corners_m=corners)
        scenario = replace(plane, parcel=(parcel,))
        _, entity = messages(scenario, plane_record, "/scene/parcels")[0]
        (body,) = entity[kind]
        assert body["pose"]["position"]["x"] == plane_record.pose[0, 0, 0]
    assert [(p["x"], p["y"]) for p in body["points"][:3]] == list(corners)
