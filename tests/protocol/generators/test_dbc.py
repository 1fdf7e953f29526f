"""The database decodes the frames of the bus."""

import logging

import cantools
import pytest

from mdms_protocol.codecs import cob, lss, nmt, sdo
from mdms_protocol.generators import dbc
from mdms_protocol.neighbours import messages


@pytest.fixture(scope="module")
def database():
    return cantools.database.load_string(dbc.text(), "dbc", strict=True)


def test_database_is_loaded_without_a_warning(caplog):
    with caplog.at_level(logging.DEBUG):
        cantools.database.load_string(dbc.text(), "dbc", strict=True)
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_database_decodes_a_bus_log_to_the_same_values(database, recorded_log):
    for carried, node_id, values, data in recorded_log:
        raw = database.decode_message(carried.can_id(node_id), data, scaling=False)
        assert tuple(raw.values()) == values
        scaled = database.decode_message(carried.can_id(node_id), data, decode_choices=False)
        for entry, value, physical in zip(carried.entries, values, scaled.values(), strict=True):
            assert physical == pytest.approx(value * entry.unit.factor)


def test_database_names_states(database):
    decoded = database.decode_message(cob.HEARTBEAT_BASE + 3, bytes((nmt.OPERATIONAL,)))
    assert str(decoded["state"]) == "operational"
    assert database.get_message_by_frame_id(cob.SYNC).length == 0


def decoded(database, can_id, data):
    values = database.decode_message(can_id, data)
    return {name: value if isinstance(value, int) else str(value) for name, value in values.items()}


def test_host_is_on_the_bus_too(database):
    assert decoded(database, 0x77F, b"\x05") == {"state": "operational"}


def test_read_and_its_answer_are_explained(database):
    assert decoded(database, 0x607, sdo.read_request(0x1018, 4)) == {
        "command": "upload",
        "upload_index": 0x1018,
        "upload_sub": 4,
    }
    answer = decoded(database, 0x587, bytes.fromhex("43 1810 04 78563412"))
    assert answer["command"] == "upload"
    assert (answer["upload_expedited"], answer["upload_unused"]) == (1, 0)
    assert answer["upload_value"] == 0x12345678


def test_write_and_its_refusal_are_explained(database):
    request = decoded(database, 0x607, sdo.write_request(0x3000, 0, b"\x4d\x00"))
    assert (request["command"], request["download_index"]) == ("download", 0x3000)
    assert (request["download_unused"], request["download_value"]) == (2, 0x4D)
    assert decoded(database, 0x587, sdo.abort(0x3000, 0, sdo.TOO_HIGH)) == {
        "command": "abort",
        "abort_index": 0x3000,
        "abort_sub": 0,
        "abort_code": "too high",
    }


@pytest.mark.parametrize("can_id", [0x607, 0x587])
def test_whatever_an_sdo_begins_with_is_explained(database, can_id):
    for first in range(256):
        assert "command" in decoded(database, can_id, bytes((first, 1, 2, 3, 4, 5, 6, 7)))


def test_segments_of_a_transfer_are_explained(database):
    assert decoded(database, 0x587, bytes.fromhex("1b 68656c00000000")) == {
        "command": "upload segment",
        "upload_segment_last": 1,
        "upload_segment_unused": 5,
        "upload_segment_toggle": 1,
        "upload_segment_data": 0x6C6568,
    }


def test_layer_setting_is_explained(database):
    scan = bytes((lss.FAST_SCAN, 0x53, 0x4D, 0x44, 0x4D, 31, 1, 2))
    assert decoded(database, 0x7E5, scan) == {
        "command": "fast scan",
        "fast_scan_number": 0x4D444D53,
        "fast_scan_bit": 31,
        "fast_scan_part": 1,
        "fast_scan_next_part": 2,
    }
    assert decoded(database, 0x7E4, bytes((lss.IDENTIFIED, *bytes(7))))["command"] == "identified"


def test_all_layer_setting_commands_are_explained(database):
    # CiA 305: global, configure, store; selective; identify; fast scan; inquire
    codes = (0x04, 0x11, 0x13, 0x15, 0x17, *range(0x40, 0x44), *range(0x46, 0x4D), 0x51)
    for code in (*codes, *range(0x5A, 0x5F)):
        assert decoded(database, 0x7E5, bytes((code, *bytes(7))))["command"]
    for code in (0x11, 0x13, 0x17, 0x44, 0x4F, 0x50, *range(0x5A, 0x5F)):
        assert decoded(database, 0x7E4, bytes((code, *bytes(7))))["command"]


def test_estimate_is_taken_apart(database):
    estimate = messages.Estimate(-40, 400, -1024, 9, 3, 0x81, 7, 4, 2, 5)
    assert database.decode_message(0x387, messages.encode_estimate(estimate)) == {
        "x": pytest.approx(-0.01),
        "y": pytest.approx(0.1),
        "yaw": -90,
        "identity": 9,
        "state": "under the parcel",
        "wants": 0x81,
        "certainty": 7,
        "hold": 4,
        "sequence": 2,
        "arrived": 1,
        "lacking": 0,
        "contradicted": 1,
    }


@pytest.mark.parametrize("can_id", [0x47F, 0x487])
def test_program_is_taken_apart_page_by_page(database, can_id):
    parcel = messages.Parcel(5, 1, 1, 1200, 1200, 98, 40, 1)
    assert database.decode_message(can_id, messages.encode_page(parcel)) == {
        "identity": 5,
        "page": "parcel",
        "sequence": 1,
        "parcel_shape": "disc",
        "parcel_length": pytest.approx(0.3),
        "parcel_width": pytest.approx(0.3),
        "parcel_acceleration": pytest.approx(0.98),
        "parcel_speed": pytest.approx(0.2),
        "parcel_go_on": 1,
        "parcel_any_yaw": 0,
    }
    page = messages.encode_page(messages.Goal(5, 2, -800, 4, 512, 0, 0))
    goal = database.decode_message(can_id, page)
    assert (goal["goal_x"], goal["goal_y"]) == (pytest.approx(-0.2), pytest.approx(0.001))
    assert (goal["goal_yaw"], goal["goal_leg"], goal["goal_legs"]) == (45, 0, 0)
    leg = database.decode_message(can_id, messages.encode_page(messages.Goal(5, 2, 0, 0, 0, 2, 6)))
    assert (leg["goal_leg"], leg["goal_legs"]) == (2, 6)
    end = database.decode_message(can_id, messages.encode_page(messages.End(5, 2)))
    assert end == {"identity": 5, "page": "end", "sequence": 2}
