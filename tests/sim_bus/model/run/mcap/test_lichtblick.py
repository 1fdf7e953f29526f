"""The layout for Lichtblick names nothing that is not in the run's file, and its form is theirs.

The checks of the form, of message paths and of schemas are those of Lichtblick's own readers
(`CurrentLayoutProvider`, `message-path/grammar.ne`, `mcap-support/parseJsonSchema`).
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from mdms_model.run.folder import LAYOUT, fresh_folder, write_run
from mdms_model.run.record import Plan
from mdms_model.scenario.file import load_scenario

_TOPIC = r"""(?:"((?:[^"\\]|\\.)+)"|(/[\w/-]*))"""
PATH = re.compile(_TOPIC + r"((?:\.[\w-]+(?:\[\d+\])?)*)", re.ASCII)
PANELS = {"3D", "Plot", "RosOut"}


def leaves(tree):
    """Names of the panels of a window; each split is in two."""
    if isinstance(tree, str):
        return [tree]
    assert tree["direction"] in {"row", "column"}
    assert 0 < tree["splitPercentage"] < 100
    return leaves(tree["first"]) + leaves(tree["second"])


def parsed(path):
    """Topic, and the fields and indices after it."""
    match = PATH.fullmatch(path)
    assert match, path
    topic = re.sub(r"\\(.)", r"\1", match[1]) if match[1] else match[2]
    return topic, re.findall(r"\.([\w-]+)(?:\[(\d+)\])?", match[3])


def found_at(message, fields):
    for name, index in fields:
        message = message.get(name) if isinstance(message, dict) else None
        if index and message is not None:
            message = message[int(index)]
    return message


def check_schema(schema, where="message"):
    """One type each, as a viewer takes them."""
    assert schema["type"] == "object", where
    for name, whole in schema.get("properties", {}).items():
        part = whole["items"] if whole["type"] == "array" else whole
        assert part["type"] in ("boolean", "string", "number", "integer", "object"), (where, name)
        if part["type"] == "object":
            check_schema(part, f"{where}.{name}")


def kept(folder, scenario, record):
    """The layout, and by topic the schemas' names and messages."""
    with fresh_folder(folder) as partial:
        write_run(partial, scenario, record, {})
    topics = {}
    with (folder / "run.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            check_schema(json.loads(schema.data), schema.name)
            topics.setdefault(channel.topic, (schema.name, []))[1].append(json.loads(message.data))
    return json.loads((folder / LAYOUT).read_text("utf-8")), topics


def check(layout, topics):
    assert {*layout} >= {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    panels = layout["configById"]
    names = leaves(layout["layout"])
    assert sorted(names) == sorted(panels)
    assert {name.partition("!")[0] for name in names} == PANELS
    (scene,) = (panel for name, panel in panels.items() if name.startswith("3D!"))
    scenes = {topic for topic, (schema, _) in topics.items() if schema == "foxglove.SceneUpdate"}
    assert {*scene["topics"]} == scenes
    assert all(each["visible"] for each in scene["topics"].values())
    frames = {
        entity["frame_id"]
        for topic in scenes
        for message in topics[topic][1]
        for entity in message["entities"]
    }
    assert frames == {scene["followTf"]}
    (log,) = (panel for name, panel in panels.items() if name.startswith("RosOut!"))
    assert topics[log["topicToRender"]][0] == "foxglove.Log"
    plots = [panel for name, panel in panels.items() if name.startswith("Plot!")]
    paths = [path["value"] for plot in plots for path in plot["paths"]]
    assert all(plot["paths"] for plot in plots)
    for path in paths:
        topic, fields = parsed(path)
        values = [found_at(message, fields) for message in topics[topic][1]]
        assert any(isinstance(value, float) for value in values), path
    return paths


def test_layout_names_the_topics_of_a_simulated_run(tmp_path, plane, plane_record):
    plans = [Plan(0.5, {"box": np.zeros((2, 3))}, goals={"box": np.zeros(3)})]
    presence = np.zeros((len(plane_record.time_s), 18), np.uint8)
    record = replace(plane_record, plans=plans, presence=presence)
    paths = check(*kept(tmp_path / "run", plane, record))
    assert "/parcel/box.x_m" in paths
    assert "/parcel/box.estimate_off.place_mm" in paths


def test_layout_names_the_topics_of_a_run_on_hardware(tmp_path, plane, believed_record):
    believed_record.speed_m_s[:5, 3] = np.nan
    paths = check(*kept(tmp_path / "run", plane, believed_record))
    assert "/parcel/box.estimate.x_m" in paths
    assert not any("estimate_off" in path for path in paths)


def test_layout_names_the_topics_of_a_run_that_cells_steered(tmp_path, plane, plane_record):
    cells = np.zeros((len(plane_record.time_s), 18), np.int8)
    belief = np.full((*cells.shape, 3), np.nan)
    record = replace(plane_record, identity=cells, state=cells, belief=belief)
    check(*kept(tmp_path / "run", plane, record))


@pytest.mark.parametrize("name", ["small 1", 'the "big" one', r"a\b", "a.b", "数"])
def test_parcel_of_any_name_is_found_by_the_paths(tmp_path, plane, plane_record, name):
    scenario = replace(plane, parcel=(replace(plane.parcel[0], name=name),))
    check(*kept(tmp_path / "run", scenario, plane_record))


def test_disc_has_no_turn_to_be_off(tmp_path, plane, plane_record):
    disc = replace(plane.parcel[0], shape="disc", length_m=0.3, width_m=0.3)
    paths = check(*kept(tmp_path / "run", replace(plane, parcel=(disc,)), plane_record))
    assert [path for path in paths if "off" in path] == ["/parcel/box.estimate_off.place_mm"]


def test_row_of_wheels_has_a_layout(tmp_path, plane_record):
    row = load_scenario("paper-fig7")
    names = ("reference_m_s", "speed_m_s", "voltage_v", "normal_n", "force_n", "contact")
    cut = {name: getattr(plane_record, name)[:, :10] for name in names}
    check(*kept(tmp_path / "run", row, replace(plane_record, estimate=None, **cut)))
