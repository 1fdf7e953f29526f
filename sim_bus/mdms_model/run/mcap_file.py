"""A `Record` as an MCAP file with JSON messages, which Foxglove, Lichtblick and PlotJuggler read.

Topics: `/parcel/NAME` and `/wheels` at every sample, `/cells` too where cells steered, `/events`
where something happened, `/plan` where one took effect, `/scene` for the eyes. All but the scene
also carry their time in seconds to the last bit; MCAP's own is in whole nanoseconds. JSON has no
NaN: what is no number is left out of a parcel's message, and is null in an array of the wheels,
whose schema allows it then, or of the cells. An array without any number is left out.
"""

import heapq
import json
from collections.abc import Iterator
from dataclasses import asdict, fields
from itertools import repeat
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import Writer

from mdms_model.arrays import Floats
from mdms_model.run.cell_reports import REPORTED
from mdms_model.run.record import Event, Plan, Record, RecordFileError, Tile
from mdms_model.run.scene_3d import SCENE_SCHEMA, scene_messages
from mdms_model.scenario.scenario import Parcel, Scenario

NS_PER_S = 1_000_000_000
POSE = ("x_m", "y_m", "yaw_rad")
TWIST = ("vx_m_s", "vy_m_s", "yaw_rate_rad_s")
#: The arrays of shape (T, W) in a record.
WHEELS = tuple(
    item.name
    for item in fields(Record)
    if item.name not in {"time_s", "pose", "twist", "estimate", "events", "plans", *REPORTED}
)
#: Those that every record has, of numbers or of NaN.
ARRAYS = tuple(name for name in WHEELS if name not in {"contact", "slip_m_s"})

_TEXT, _INTEGER, _NUMBER = {"type": "string"}, {"type": "integer"}, {"type": "number"}
_NUMBERS = {"type": "array", "items": _NUMBER}
_INTEGERS = {"type": "array", "items": _INTEGER}
#: Only where a record needs it: not every reader of schemas takes two types.
_NUMBERS_OR_NULL = {"type": "array", "items": {"type": ["number", "null"]}}
_POSE_SCHEMA = {"type": "object", "properties": dict.fromkeys(POSE, _NUMBER)}


def _objects(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": {"type": "object", "properties": properties}}


SCHEMAS: dict[str, dict[str, Any]] = {
    "mdms.Parcel": dict.fromkeys(("time_s", *POSE, *TWIST), _NUMBER) | {"estimate": _POSE_SCHEMA},
    "mdms.Wheels": {"time_s": _NUMBER} | dict.fromkeys(WHEELS, _NUMBERS),
    "mdms.Cells": {
        "time_s": _NUMBER,
        **dict.fromkeys(("identity", "state"), _INTEGERS),
        **dict.fromkeys(POSE, _NUMBERS_OR_NULL),
    },
    "mdms.Event": {
        "time_s": _NUMBER,
        **dict.fromkeys(("kind", "detail", "parcel"), _TEXT),
        **dict.fromkeys(("cell", "axis"), _INTEGER),
    },
    "mdms.Plan": {
        "time_s": _NUMBER,
        "ways": _objects({"parcel": _TEXT} | dict.fromkeys(POSE, _NUMBERS)),
        "tiles": _objects(
            dict.fromkeys(("x_m", "y_m", "side_m"), _NUMBER)
            | {"parcels": {"type": "array", "items": _TEXT}}
        ),
    },
    "foxglove.SceneUpdate": SCENE_SCHEMA,
}
_CELLS, _PLAN = "/cells", "/plan"
#: A message and when it belongs [s].
Timed: TypeAlias = tuple[float, dict[str, Any]]


def write_record(path: Path, scenario: Scenario, record: Record) -> None:
    """Write all samples and events of a run, and the scene that they make. Raises OSError."""
    sources = [
        ("/scene", "foxglove.SceneUpdate", scene_messages(scenario, record.with_belief())),
        ("/wheels", "mdms.Wheels", _wheel_messages(record)),
        ("/events", "mdms.Event", _event_messages(record)),
    ]
    if record.identity is not None:
        sources.append((_CELLS, "mdms.Cells", _cell_messages(record)))
    if record.plans:
        sources.append((_PLAN, "mdms.Plan", _plan_messages(record)))
    for number, parcel in enumerate(scenario.parcel):
        sources.append((_topic(parcel), "mdms.Parcel", _parcel_messages(record, number)))
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="mdms-array")
        schemas = _register_schemas(writer, record)
        channels = {
            writer.register_channel(topic, "json", schemas[schema]): messages
            for topic, schema, messages in sources
        }
        _add_messages(writer, channels)
        writer.finish()  # type: ignore[no-untyped-call]


def read_record(path: Path, scenario: Scenario) -> Record:
    """Read what `write_record` wrote. Raises `RecordFileError` or OSError."""
    parcels = [_topic(parcel) for parcel in scenario.parcel]
    topics = ("/wheels", _CELLS, _PLAN, "/events", *parcels)
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in topics}
    try:
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(topics=list(found)):
                found[channel.topic].append(json.loads(message.data))
        return _record(found, [found[topic] for topic in parcels])
    except (McapError, ValueError, KeyError, IndexError, TypeError) as error:
        raise RecordFileError(f"{path}: holds no record of these parcels: {error}") from None


def _topic(parcel: Parcel) -> str:
    return f"/parcel/{parcel.name}"


def _register_schemas(writer: Writer, record: Record) -> dict[str, int]:
    """The numbers of all schemas by name."""
    numbers = {}
    gaps = dict.fromkeys(_with_gaps(record), _NUMBERS_OR_NULL)
    for name, known in SCHEMAS.items():
        properties = known | gaps if name == "mdms.Wheels" else known
        schema = {"title": name, "type": "object", "properties": properties}
        numbers[name] = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
    return numbers


def _with_gaps(record: Record) -> Iterator[str]:
    return (name for name, array in _known_arrays(record) if not np.isfinite(array).all())


def _known_arrays(record: Record) -> Iterator[tuple[str, Any]]:
    """The wheels' arrays that have a number at all."""
    for name in WHEELS:
        array = getattr(record, name)
        if array is not None and np.isfinite(array).any():
            yield name, array


def _add_messages(writer: Writer, channels: dict[int, Iterator[Timed]]) -> None:
    """Interleave the messages of all channels by time, as players like to find them."""
    streams = [zip(repeat(channel), timed, strict=False) for channel, timed in channels.items()]
    for channel, (time_s, message) in heapq.merge(*streams, key=lambda pair: pair[1][0]):
        time_ns = round(time_s * NS_PER_S)
        data = json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
        writer.add_message(channel, time_ns, data, time_ns)


def _parcel_messages(record: Record, number: int) -> Iterator[Timed]:
    states = _plain(np.hstack((record.pose[:, number], record.twist[:, number])))
    estimates: Any = repeat(None)
    if record.estimate is not None:
        estimates = _plain(record.estimate[:, number])
    for time_s, state, estimate in zip(record.time_s.tolist(), states, estimates, strict=False):
        message = {"time_s": time_s, **_known(POSE + TWIST, state)}
        if estimate is not None:
            message["estimate"] = _known(POSE, estimate)
        yield time_s, message


def _known(names: tuple[str, ...], values: list[float | None]) -> dict[str, float]:
    """Values by name, without those that are no numbers."""
    pairs = zip(names, values, strict=True)
    return {name: value for name, value in pairs if value is not None}


def _wheel_messages(record: Record) -> Iterator[Timed]:
    present = {name: _plain(array) for name, array in _known_arrays(record)}
    for time_s, *rows in zip(record.time_s.tolist(), *present.values(), strict=True):
        yield time_s, {"time_s": time_s, **dict(zip(present, rows, strict=True))}


def _cell_messages(record: Record) -> Iterator[Timed]:
    """What the cells reported, by cell: with whom, in which state, where they believe it to be."""
    beliefs = _plain(record.belief)
    rows = zip(record.time_s.tolist(), record.identity, record.state, beliefs, strict=True)  # type: ignore[arg-type]
    for time_s, identity, state, belief in rows:
        message = {"time_s": time_s, "identity": identity.tolist(), "state": state.tolist()}
        yield time_s, message | dict(zip(POSE, zip(*belief, strict=True), strict=True))


def _event_messages(record: Record) -> Iterator[Timed]:
    for event in sorted(record.events, key=lambda event: event.time_s):
        yield event.time_s, {k: v for k, v in asdict(event).items() if v is not None}


def _plan_messages(record: Record) -> Iterator[Timed]:
    for plan in record.plans:
        ways = [
            {"parcel": name, **dict(zip(POSE, poses.T.tolist(), strict=True))}
            for name, poses in plan.ways.items()
        ]
        tiles = [asdict(tile) for tile in plan.tiles]
        yield plan.time_s, {"time_s": plan.time_s, "ways": ways, "tiles": tiles}


def _plan(row: dict[str, Any]) -> Plan:
    ways = {way["parcel"]: np.array([way[name] for name in POSE]).T for way in row["ways"]}
    tiles = (Tile(**tile | {"parcels": tuple(tile["parcels"])}) for tile in row["tiles"])
    return Plan(row["time_s"], ways, tuple(tiles))


def _plain(array: Any) -> Any:
    """Nested lists with None for what is not a number: JSON has no NaN."""
    finite: Any = np.isfinite(array)
    shown: Any = array if finite.all() else np.where(finite, array.astype(object), None)
    return shown.tolist()


def _record(topics: dict[str, list[dict[str, Any]]], parcels: list[list[dict[str, Any]]]) -> Record:
    wheels = topics["/wheels"]
    present = [name for name in WHEELS if wheels and name in wheels[0]]
    columns = {name: np.array([row[name] for row in wheels], dtype=float) for name in present}
    contact = columns.pop("contact").astype(np.int8)
    columns |= _reports(topics[_CELLS])
    for name in ARRAYS:
        columns.setdefault(name, np.full(contact.shape, np.nan))
    return Record(
        time_s=np.array([row["time_s"] for row in wheels]),
        pose=_stack(parcels, POSE),
        twist=_stack(parcels, TWIST),
        estimate=_estimates(parcels),
        contact=contact,
        events=[Event(**row) for row in topics["/events"]],
        plans=[_plan(row) for row in topics[_PLAN]],
        **columns,
    )


def _reports(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the cells reported, if they have."""
    if not rows:
        return {}
    belief = np.array([[row[name] for name in POSE] for row in rows], dtype=float)
    return {
        "identity": np.array([row["identity"] for row in rows], np.int8),
        "state": np.array([row["state"] for row in rows], np.int8),
        "belief": belief.transpose(0, 2, 1),
    }


def _stack(parcels: list[list[dict[str, Any]]], names: tuple[str, ...]) -> Floats:
    rows = [[[row.get(name) for name in names] for row in parcel] for parcel in parcels]
    columns: Floats = np.array(rows, dtype=float)
    return columns.transpose(1, 0, 2)


def _estimates(parcels: list[list[dict[str, Any]]]) -> Floats | None:
    if "estimate" not in parcels[0][0]:
        return None
    return _stack([[row["estimate"] for row in parcel] for parcel in parcels], POSE)
