"""Events as lines of a log that viewers show in a panel of its own, as `foxglove.Log`."""

from collections.abc import Iterator
from enum import IntEnum
from typing import Any

from mdms_model.run.record import Event, Record

LOG_TOPIC, LOG_SCHEMA_NAME = "/log", "foxglove.Log"
_TEXT, _INTEGER = {"type": "string"}, {"type": "integer"}
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
