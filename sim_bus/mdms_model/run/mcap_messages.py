"""A `Record` as messages of plain numbers and text, by topic, each with its schema.

JSON has no NaN: a value without a number is left out of a parcel's message, and is null in an array
of the wheels or the cells. Such an array is left out of the schema, for viewers refuse a schema
that allows two types. An array without any number is left out of the messages too. Events are lines
of a log that viewers show in a panel of its own, as `foxglove.Log`.
"""

from collections.abc import Iterator
from dataclasses import asdict, fields
from enum import IntEnum
from itertools import repeat
from typing import Any, TypeAlias

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.run.derived import goals_at, goals_given, host_error
from mdms_model.run.frame_readers import REPORTED
from mdms_model.run.record import Event, Record
from mdms_model.scenario.scenario import Parcel, Scenario

POSE = ("x_m", "y_m", "yaw_rad")
TWIST = ("vx_m_s", "vy_m_s", "yaw_rate_rad_s")
#: How far a belief is off, for eyes.
OFF = ("place_mm", "yaw_deg")
#: The arrays of shape (T, W) in a record.
_OTHERS = {"time_s", "pose", "twist", "estimate", "events", "plans", "presence", *REPORTED}
WHEELS = tuple(item.name for item in fields(Record) if item.name not in _OTHERS)
WHEELS_TOPIC, CELLS_TOPIC, PLAN_TOPIC = "/wheels", "/cells", "/plan"
EVENTS_TOPIC, COMMANDS_TOPIC = "/events", "/commands"

_TEXT, _INTEGER = {"type": "string"}, {"type": "integer"}
_NUMBER = {"type": "number"}
_NUMBERS = {"type": "array", "items": _NUMBER}
_INTEGERS = {"type": "array", "items": _INTEGER}
_POSE_SCHEMA = {"type": "object", "properties": dict.fromkeys(POSE, _NUMBER)}
_OFF_SCHEMA = {"type": "object", "properties": dict.fromkeys(OFF, _NUMBER)}


def _objects(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": {"type": "object", "properties": properties}}


SCHEMAS: dict[str, dict[str, Any]] = {
    "mdms.Parcel": dict.fromkeys(("time_s", *POSE, *TWIST), _NUMBER)
    | dict.fromkeys(("estimate", "goal"), _POSE_SCHEMA)
    | {"estimate_off": _OFF_SCHEMA},
    "mdms.Wheels": {"time_s": _NUMBER} | dict.fromkeys(WHEELS, _NUMBERS),
    "mdms.Cells": {
        "time_s": _NUMBER,
        **dict.fromkeys(("presence", "identity", "state"), _INTEGERS),
    },
    "mdms.Event": {
        "time_s": _NUMBER,
        **dict.fromkeys(("kind", "detail", "parcel"), _TEXT),
        **dict.fromkeys(("cell", "axis"), _INTEGER),
    },
    "mdms.Command": {
        "time_s": _NUMBER,
        "parcel": _TEXT,
        **dict.fromkeys(POSE, _NUMBER),
    },
    "mdms.Plan": {
        "time_s": _NUMBER,
        "goals": _objects({"parcel": _TEXT} | dict.fromkeys(POSE, _NUMBER)),
        "ways": _objects({"parcel": _TEXT} | dict.fromkeys((*POSE, "due_s"), _NUMBERS)),
        "tiles": _objects(
            dict.fromkeys(("x_m", "y_m", "side_m"), _NUMBER)
            | {"parcels": {"type": "array", "items": _TEXT}}
        ),
    },
}
#: A message and when it belongs [s].
Timed: TypeAlias = tuple[float, dict[str, Any]]
#: A topic, the name of its schema, and its messages.
Source: TypeAlias = tuple[str, str, Iterator[Timed]]


def sources(scenario: Scenario, record: Record) -> Iterator[Source]:
    """All topics that a record gives."""
    yield WHEELS_TOPIC, "mdms.Wheels", _wheel_messages(record)
    yield EVENTS_TOPIC, "mdms.Event", _event_messages(record)
    if record.identity is not None or record.presence is not None:
        yield CELLS_TOPIC, "mdms.Cells", _cell_messages(record)
    if record.plans:
        yield PLAN_TOPIC, "mdms.Plan", _plan_messages(record)
        yield COMMANDS_TOPIC, "mdms.Command", _command_messages(record)
    for number, parcel in enumerate(scenario.parcel):
        yield parcel_topic(parcel), "mdms.Parcel", _parcel_messages(scenario, record, number)


def schemas_of(record: Record) -> dict[str, dict[str, Any]]:
    """The schemas as all messages of this record meet them."""
    gaps = {name for name, array in known_arrays(record) if not np.isfinite(array).all()}
    wheels = {name: each for name, each in SCHEMAS["mdms.Wheels"].items() if name not in gaps}
    return SCHEMAS | {"mdms.Wheels": wheels}


def parcel_topic(parcel: Parcel) -> str:
    """Where a parcel's messages are."""
    return f"/parcel/{parcel.name}"


def known_arrays(record: Record) -> Iterator[tuple[str, Any]]:
    """The wheels' arrays that have a number at all."""
    for name in WHEELS:
        array = getattr(record, name)
        if array is not None and np.isfinite(array).any():
            yield name, array


def _parcel_messages(scenario: Scenario, record: Record, number: int) -> Iterator[Timed]:
    states = _plain(np.hstack((record.pose[:, number], record.twist[:, number])))
    estimates: Any = repeat(None)
    if record.estimate is not None:
        estimates = _plain(record.estimate[:, number])
    offs = _plain(host_error(scenario, record, number) * (1e3, 180 / np.pi))
    name = scenario.parcel[number].name
    rows = zip(record.time_s.tolist(), states, estimates, offs, strict=False)
    for time_s, state, estimate, off in rows:
        message = {"time_s": time_s, **_known(POSE + TWIST, state)}
        if estimate is not None:
            message["estimate"] = _known(POSE, estimate)
        if off[0] is not None:
            message["estimate_off"] = _known(OFF, off)
        if (goal := goals_at(scenario, record, time_s).get(name)) is not None:
            message["goal"] = _known(POSE, _plain(goal))
        yield time_s, message


def _known(names: tuple[str, ...], values: list[float | None]) -> dict[str, float]:
    """Values by name, without those that are no numbers."""
    pairs = zip(names, values, strict=True)
    return {name: value for name, value in pairs if value is not None}


def _wheel_messages(record: Record) -> Iterator[Timed]:
    present = {name: _plain(array) for name, array in known_arrays(record)}
    for time_s, *rows in zip(record.time_s.tolist(), *present.values(), strict=True):
        yield time_s, {"time_s": time_s, **dict(zip(present, rows, strict=True))}


def _cell_messages(record: Record) -> Iterator[Timed]:
    """The reports of the cells, by cell: with whom, in which state, where they believe it to be."""
    columns: dict[str, Any] = {}
    for name in ("presence", "identity", "state"):
        if (array := getattr(record, name)) is not None:
            columns[name] = array.tolist()
    if record.belief is not None:
        columns |= dict(zip(POSE, map(_plain, np.moveaxis(record.belief, 2, 0)), strict=True))
    for time_s, *rows in zip(record.time_s.tolist(), *columns.values(), strict=True):
        yield time_s, {"time_s": time_s, **dict(zip(columns, rows, strict=True))}


def _event_messages(record: Record) -> Iterator[Timed]:
    for event in sorted(record.events, key=lambda event: event.time_s):
        yield event.time_s, {k: v for k, v in asdict(event).items() if v is not None}


def _plan_messages(record: Record) -> Iterator[Timed]:
    for plan in record.plans:
        ways = []
        for name, poses in plan.ways.items():
            way: dict[str, Any] = {"parcel": name, **dict(zip(POSE, poses.T.tolist(), strict=True))}
            if name in plan.due_s:
                way["due_s"] = plan.due_s[name].tolist()
            ways.append(way)
        goals = [_goal(name, goal) for name, goal in plan.goals.items()]
        tiles = [asdict(tile) for tile in plan.tiles]
        message = {"time_s": plan.time_s, "goals": goals, "ways": ways, "tiles": tiles}
        yield plan.time_s, message


def _command_messages(record: Record) -> Iterator[Timed]:
    """Each goal that a parcel is given, when it is."""
    for time_s, name, goal in goals_given(record):
        yield time_s, {"time_s": time_s, **_goal(name, goal)}


def _goal(name: str, pose: Floats) -> dict[str, Any]:
    return {"parcel": name, **_known(POSE, _plain(pose))}


def _plain(array: Any) -> Any:
    """Nested lists with None for a NaN: JSON has no NaN."""
    finite: Any = np.isfinite(array)
    shown: Any = array if finite.all() else np.where(finite, array.astype(object), None)
    return shown.tolist()


LOG_TOPIC, LOG_SCHEMA_NAME = "/log", "foxglove.Log"
LOG_SCHEMA: dict[str, Any] = {
    "timestamp": {"type": "object", "properties": dict.fromkeys(("sec", "nsec"), _INTEGER)},
    "level": _INTEGER,
    **dict.fromkeys(("message", "name", "file"), _TEXT),
    "line": _INTEGER,
}


class Level(IntEnum):
    """As the schema numbers them."""

    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4


#: Of events by kind; others are `INFO`.
_LEVELS = {
    **dict.fromkeys(("support", "contact", "reversal"), Level.DEBUG),
    **dict.fromkeys(("fault", "touch", "link"), Level.WARNING),
    **dict.fromkeys(("tip", "solver", "violation"), Level.ERROR),
}


def log_messages(record: Record) -> Iterator[tuple[float, dict[str, Any]]]:
    """Times [s] and lines, in their order."""
    for event in sorted(record.events, key=lambda event: event.time_s):
        time_ns = round(event.time_s * 1e9)
        yield (
            event.time_s,
            {
                "timestamp": {"sec": time_ns // 10**9, "nsec": time_ns % 10**9},
                "level": int(_LEVELS.get(event.kind, Level.INFO)),
                "message": _words(event),
                "name": event.kind,
                "file": "",
                "line": 0,
            },
        )


def _words(event: Event) -> str:
    places = {"parcel": event.parcel, "cell": event.cell, "axis": event.axis}
    named = " ".join(f"{name} {value}" for name, value in places.items() if value is not None)
    return f"{named}: {event.detail}" if named else event.detail
