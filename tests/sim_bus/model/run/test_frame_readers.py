"""The cells' reports of their parcels: read off the bus, into a file and back, in 3D."""

from dataclasses import replace

import numpy as np
import pytest

from mdms_model.array import cell_centres
from mdms_model.buses import address_cells
from mdms_model.run.frame_readers import SILENT_S, CellReports
from mdms_model.run.mcap_file import read_record, write_record
from mdms_model.run.mcap_scene import layers, scene_messages
from mdms_model.run.record import Contact, Record
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages

SCENARIO = load_scenario("neighbours")
CENTRES_M = cell_centres(SCENARIO.array)
USUAL = messages.Estimate(-40, 0, 1024, 2, wire.UNDER, 0, 9, wire.HOLD_NONE, 1, 0)


def frame(cell, **fields):
    return Frame(0x380 + cell, messages.encode_estimate(USUAL._replace(**fields)))


@pytest.fixture
def reports():
    return CellReports(CENTRES_M, address_cells(18))


def test_a_cell_reports_identity_state_and_belief_in_the_frame_of_the_table(reports):
    reports.on_frame(0, frame(1), 1.0)
    sample = reports.sample(1.0)
    assert reports.any
    assert sample["identity"].tolist() == [2] + 17 * [0]
    assert sample["state"].tolist() == [wire.UNDER] + 17 * [wire.NONE]
    x_m, y_m = CENTRES_M[0]
    assert sample["belief"][0] == pytest.approx([x_m - 0.01, y_m, np.pi / 2])
    assert np.isnan(sample["belief"][1:]).all()


def test_a_cell_without_a_pose_believes_nothing(reports):
    reports.on_frame(0, frame(3, certainty=0, state=wire.PROMISED), 1.0)
    sample = reports.sample(1.0)
    assert sample["state"][2] == wire.PROMISED
    assert np.isnan(sample["belief"]).all()


def test_a_cell_that_has_fallen_silent_has_no_parcel(reports):
    reports.on_frame(0, frame(1), 1.0)
    assert reports.sample(1.0 + 0.9 * SILENT_S)["identity"][0] == 2
    late = reports.sample(1.01 + SILENT_S)
    assert not late["identity"].any()
    assert not late["state"].any()


def test_a_frame_that_is_no_estimate_changes_nothing(reports):
    reports.on_frame(0, Frame(0x381, b"\x01"), 1.0)
    assert not reports.any
    assert not reports.sample(1.0)["identity"].any()


def record_of(states):
    """Samples in which cell 1 is in each of the states, with parcel 1 but in the state NONE."""
    times, wheels = len(states), (len(states), 36)
    state = np.zeros((times, 18), np.int8)
    state[:, 0] = states
    belief = np.full((times, 18, 3), np.nan)
    belief[:, 0] = (0.1, 0.2, 0.3)
    return Record(
        time_s=0.1 * np.arange(times),
        pose=np.zeros((times, 1, 3)),
        twist=np.zeros((times, 1, 3)),
        **dict.fromkeys(
            ("reference_m_s", "speed_m_s", "voltage_v", "normal_n", "force_n"), np.zeros(wheels)
        ),
        contact=np.full(wheels, Contact.NONE, np.int8),
        identity=(state > 0).astype(np.int8),
        state=state,
        belief=belief,
    )


def test_a_record_file_gives_back_the_reports_of_the_cells(tmp_path):
    record = record_of([wire.NEAR, wire.UNDER])
    write_record(tmp_path / "run.mcap", SCENARIO, record)
    again = read_record(tmp_path / "run.mcap", SCENARIO)
    np.testing.assert_array_equal(again.identity, record.identity)
    np.testing.assert_array_equal(again.state, record.state)
    np.testing.assert_array_equal(again.belief, record.belief)


def test_a_record_of_cells_that_obey_has_no_reports(tmp_path):
    record = replace(record_of([0]), identity=None, state=None, belief=None)
    write_record(tmp_path / "run.mcap", SCENARIO, record)
    assert read_record(tmp_path / "run.mcap", SCENARIO).identity is None


def test_scene_shows_a_cell_with_a_parcel_a_promised_one_as_a_frame_and_one_that_is_free_not():
    states = [wire.NEAR, wire.PROMISED, wire.UNDER, wire.UNDER, wire.NONE]
    record = record_of(states)
    (cells,) = (each for each in layers(SCENARIO, record) if each.topic == "/scene/cells")
    shown = [
        (
            round(time_s, 1),
            len(message["entities"][0]["lines"]),
            len(message["entities"][0]["cubes"]),
        )
        for time_s, message in scene_messages(cells, record)
    ]
    assert shown == [(0.0, 0, 0), (0.1, 1, 0), (0.2, 0, 1), (0.4, 0, 0)]
