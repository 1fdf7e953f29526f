"""One schema defines every command, and exactly the commands that it allows are taken."""

import jsonschema
import pytest

from mdms_host.page import commands
from mdms_host.page.commands import COMMANDS, PageRefusedError, command_from, schema
from mdms_model.scenario.fault import Fault

SCHEMA = schema(tuple(COMMANDS))
GOOD = (
    {"command": "goal", "parcel": "box", "x_m": 0.1, "y_m": -0.2, "yaw_rad": 0.5},
    {"command": "goal", "id": 7, "parcel": "box", "x_m": 1, "y_m": 0},
    {"command": "name", "parcel": "unknown 1", "name": "tray", "length_m": 0.3, "width_m": 0.2},
    {"command": "start"},
    {"command": "signal", "name": "scanner", "value": "A"},
    {"command": "signal", "name": "go"},
    {"command": "stop"},
    {"command": "stop_all"},
    {"command": "read_objects", "cell": 3},
    {"command": "fault", "fault": {"kind": "off", "cells": [3, 4]}},
    {"command": "fault", "fault": {"kind": "push", "parcel": "box", "impulse_n_s": [0.1, 0]}},
    {"command": "end_fault", "number": 1, "x_m": 0.1},
    {"command": "pause"},
    {"command": "resume"},
    {"command": "step", "duration_s": 0.5},
    {"command": "speed", "factor": 2},
    {"command": "seek", "time_s": 3.5},
    {"command": "take_control"},
    {"command": "release_control"},
)
BAD = (
    {"command": "goal", "parcel": "box", "x_m": 0.1},
    {"command": "goal", "parcel": "box", "x_m": "0.1", "y_m": 0},
    {"command": "goal", "parcel": "box", "x_m": 1e4, "y_m": 0},
    {"command": "goal", "parcel": "box", "x_m": 0, "y_m": 0, "speed_m_s": 9},
    {"command": "fly"},
    {"command": "signal", "value": "A"},
    {"command": "signal", "name": "scanner", "value": 3},
    {"command": "speed", "factor": 0},
    {"command": "speed", "factor": 1000},
    {"command": "read_objects", "cell": 0},
    {"command": "fault", "fault": {"kind": "meteor"}},
    {"command": "fault", "fault": {"kind": "push", "impulse_n_s": [1]}},
    {"command": "fault"},
    {"id": 3},
)


def test_every_command_has_an_example_here():
    assert {message["command"] for message in GOOD} == COMMANDS.keys()


@pytest.mark.parametrize("message", GOOD)
def test_a_command_that_the_schema_allows_is_taken(message):
    jsonschema.validate(message, SCHEMA)
    assert isinstance(command_from(message), COMMANDS[message["command"]])


@pytest.mark.parametrize("message", BAD)
def test_a_command_that_the_schema_forbids_is_refused(message):
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(message, SCHEMA)
    with pytest.raises(PageRefusedError):
        command_from(message)


@pytest.mark.parametrize("message", [None, [], "stop_all", 3, {"command": ["stop_all"]}])
def test_a_message_that_is_no_command_is_refused(message):
    with pytest.raises(PageRefusedError):
        command_from(message)


def test_numbers_that_are_none_are_refused():
    for number in (float("nan"), float("inf")):
        with pytest.raises(PageRefusedError, match="x_m"):
            command_from({"command": "goal", "parcel": "box", "x_m": number, "y_m": 0.0})


def test_refusal_names_the_value_and_the_limit():
    with pytest.raises(PageRefusedError, match=r"factor is 1000.*at most 100"):
        command_from({"command": "speed", "factor": 1000})


def test_fault_has_the_keys_of_a_scenario():
    (fault,) = [one for one in SCHEMA["oneOf"] if one["title"] == "fault"]
    keys = fault["properties"]["fault"]["properties"]
    assert set(keys) == set(Fault.__dataclass_fields__)
    assert keys["probability"] == {"type": "number", "minimum": 0.0, "maximum": 1.0}


def test_only_offered_commands_are_in_the_schema():
    assert [one["title"] for one in schema(("pause", "seek"))["oneOf"]] == ["pause", "seek"]
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


def test_values_arrive_as_they_were_given():
    command = command_from({"command": "goal", "parcel": "box", "x_m": 0.25, "y_m": 0})
    assert command == commands.Goal("box", 0.25, 0.0, None)


@pytest.mark.parametrize(
    "name", ["", " ", "\x1b]0;title\x07\x1b[2Jbox", "unknown-3", "a\nb", "x" * 65]
)
def test_name_that_no_parcel_can_have_is_refused(name):
    message = {"command": "name", "parcel": "unknown-1", "name": name}
    with pytest.raises(PageRefusedError, match="name is ") as refusal:
        command_from({**message, "length_m": 0.2, "width_m": 0.2})
    assert str(refusal.value).isprintable()


def test_disc_with_two_diameters_is_refused():
    message = {"command": "name", "parcel": "unknown-1", "name": "crate", "shape": "disc"}
    with pytest.raises(PageRefusedError, match=r"width_m is 0\.2, but a disc has one diameter"):
        command_from({**message, "length_m": 0.28, "width_m": 0.2})
