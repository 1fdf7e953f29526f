"""A `Record` as an MCAP file with JSON messages, which Foxglove, Lichtblick and PlotJuggler read.

Numbers: `/parcel/NAME`, `/wheels` and, of what cells reported, `/cells` at every sample; `/events`
where something happened, and the same as lines of a `/log`; `/plan` where one took effect, and
`/commands` where a parcel got a goal. For the eyes: a scene, whose topics are `/scene/...`. All but
scene and log also carry their time in seconds to the last bit; MCAP's own is in whole nanoseconds.
"""

import heapq
import json
import struct
from collections.abc import Iterator
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import Writer
from zstandard import ZstdError

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.run.mcap_messages import (
    CELLS_TOPIC,
    EVENTS_TOPIC,
    LOG_SCHEMA,
    LOG_SCHEMA_NAME,
    LOG_TOPIC,
    PLAN_TOPIC,
    POSE,
    TWIST,
    WHEELS,
    WHEELS_TOPIC,
    Source,
    Timed,
    log_messages,
    parcel_topic,
    schemas_of,
    sources,
)
from mdms_model.run.mcap_scene import SCENE_SCHEMA, layers, scene_messages
from mdms_model.run.record import Event, Plan, Record, RecordFileError, Tile
from mdms_model.scenario.scenario import Scenario

NS_PER_S = 1_000_000_000
SCENE_SCHEMA_NAME = "foxglove.SceneUpdate"
#: The wheels' arrays that every record has, of numbers or of NaN.
ARRAYS = tuple(name for name in WHEELS if name not in {"contact", "slip_m_s"})


def write_record(path: Path, scenario: Scenario, record: Record) -> None:
    """Write all samples and events of a run, and the scene that they make. Raises OSError."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="mdms-array")
        known = schemas_of(record) | {SCENE_SCHEMA_NAME: SCENE_SCHEMA, LOG_SCHEMA_NAME: LOG_SCHEMA}
        schemas = {name: _register(writer, name, schema) for name, schema in known.items()}
        channels = {
            writer.register_channel(topic, "json", schemas[schema]): messages
            for topic, schema, messages in _all_sources(scenario, record)
        }
        _add_messages(writer, channels)
        writer.finish()  # type: ignore[no-untyped-call]


#: Errors of a file that is damaged below its messages.
_UNPACKED = (McapError, ZstdError, struct.error)


def read_record(path: Path, scenario: Scenario) -> Record:
    """Read what `write_record` wrote. Raises `RecordFileError` or OSError."""
    parcels = [parcel_topic(parcel) for parcel in scenario.parcel]
    topics = (WHEELS_TOPIC, CELLS_TOPIC, PLAN_TOPIC, EVENTS_TOPIC, *parcels)
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in topics}
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            for _, channel, message in reader.iter_messages(topics=list(found)):
                found[channel.topic].append(json.loads(message.data))
        record = _record(found, [found[topic] for topic in parcels])
        wheels, expected = record.speed_m_s.shape[1], len(build_wheels(scenario).cell)
        if wheels != expected:
            raise ValueError(f"it has {wheels} wheels, and their table {expected}")
        return record
    except (*_UNPACKED, ValueError, KeyError, IndexError, TypeError) as error:
        # The reader has no words for a file that ends too soon.
        why = str(error) or "it is cut off"
        raise RecordFileError(f"{path}: holds no record of these parcels: {why}") from None


def _all_sources(scenario: Scenario, record: Record) -> Iterator[Source]:
    yield from sources(scenario, record)
    yield LOG_TOPIC, LOG_SCHEMA_NAME, log_messages(record)
    for layer in layers(scenario, record):
        yield layer.topic, SCENE_SCHEMA_NAME, scene_messages(layer, record)


def _register(writer: Writer, name: str, properties: dict[str, Any]) -> int:
    schema = {"title": name, "type": "object", "properties": properties}
    number: int = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
    return number


def _add_messages(writer: Writer, channels: dict[int, Iterator[Timed]]) -> None:
    """Interleave the messages of all channels by time, as players like to find them."""
    streams = [zip(repeat(channel), timed, strict=False) for channel, timed in channels.items()]
    for channel, (time_s, message) in heapq.merge(*streams, key=lambda pair: pair[1][0]):
        time_ns = round(time_s * NS_PER_S)
        data = json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
        writer.add_message(channel, time_ns, data, time_ns)


def _record(topics: dict[str, list[dict[str, Any]]], parcels: list[list[dict[str, Any]]]) -> Record:
    wheels = topics[WHEELS_TOPIC]
    present = [name for name in WHEELS if wheels and name in wheels[0]]
    columns = {name: np.array([row[name] for row in wheels], dtype=float) for name in present}
    contact = columns.pop("contact").astype(np.int8)
    columns |= _reports(topics[CELLS_TOPIC])
    for name in ARRAYS:
        columns.setdefault(name, np.full(contact.shape, np.nan))
    return Record(
        time_s=np.array([row["time_s"] for row in wheels]),
        pose=_stack(parcels, POSE, len(wheels)),
        twist=_stack(parcels, TWIST, len(wheels)),
        estimate=_estimates(parcels),
        contact=contact,
        events=[Event(**row) for row in topics[EVENTS_TOPIC]],
        plans=[_plan(row) for row in topics[PLAN_TOPIC]],
        **columns,
    )


def _reports(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The reports of the cells, if there are any."""
    kinds = {"presence": np.uint8, "identity": np.int8, "state": np.int8}
    present = [name for name in kinds if rows and name in rows[0]]
    reports: dict[str, Any] = {
        name: np.array([row[name] for row in rows], kinds[name]) for name in present
    }
    if "identity" in reports:
        belief = np.array([[row[name] for name in POSE] for row in rows], dtype=float)
        reports["belief"] = belief.transpose(0, 2, 1)
    return reports


def _plan(row: dict[str, Any]) -> Plan:
    ways = {way["parcel"]: np.array([way[name] for name in POSE]).T for way in row["ways"]}
    due_s = {way["parcel"]: np.array(way["due_s"]) for way in row["ways"] if "due_s" in way}
    tiles = tuple(Tile(**tile | {"parcels": tuple(tile["parcels"])}) for tile in row["tiles"])
    goals = {
        goal["parcel"]: np.array([goal.get(name, np.nan) for name in POSE])
        for goal in row.get("goals", ())
    }
    return Plan(row["time_s"], ways, tiles, due_s, goals)


def _stack(parcels: list[list[dict[str, Any]]], names: tuple[str, ...], samples: int) -> Floats:
    """Values of parcels by sample, shape (samples, P, names)."""
    if not parcels:
        return np.empty((samples, 0, len(names)))
    rows = [[[row.get(name) for name in names] for row in parcel] for parcel in parcels]
    columns: Floats = np.array(rows, dtype=float)
    return columns.transpose(1, 0, 2)


def _estimates(parcels: list[list[dict[str, Any]]]) -> Floats | None:
    if not parcels or "estimate" not in parcels[0][0]:
        return None
    estimates = [[row["estimate"] for row in parcel] for parcel in parcels]
    return _stack(estimates, POSE, len(estimates[0]))
