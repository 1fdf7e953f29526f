"""Events as the page lists them, in the order of their times, each with a remedy."""

import re
from collections import deque
from collections.abc import Iterable
from math import degrees
from typing import Any

from mdms_model.run.record import Event

#: By what an event says, the first that fits.
_ADVICE = (
    ("no cell was heard", "Check that the bus is connected and terminated and the cells powered."),
    ("fallen silent", "Check the cell's power and its bus plug."),
    ("the same node id", "Give one of the two nodes another id, then reset both."),
    ("no longer operational", "The cell has restarted: check its supply, then start again."),
    ("supply is below its limit", "Release the emergency stop, or mend the supply; start again."),
    ("supply was cut", "Release the emergency stop, look around, then start again."),
    ("disabled its drives", "Click on the cell for its errors; remove the cause and start again."),
    ("does not follow", "See whether the wheel is held or its encoder unplugged."),
    ("contradict all others", "Clean the cell's sensors, and look whether something lies on them."),
    ("has not been found", "Put the parcel where the program expects it, flat on the wheels."),
    ("look alike", "See which is which; stop the run, or give their places, if it is wrong."),
    ("has no way", "Clear the way by hand, or give the parcel another goal."),
    ("does not move as its cells", "See what holds the parcel; a new goal has it steered again."),
    ("does not get on", "See what holds the parcel; a new goal has it steered again."),
    ("another host", "Only one program may drive the cells: end the other one."),
    ("not set up as this run expects", "`mdms configure restore` sets the cell back."),
    ("settings not written", "Start the program again; `mdms configure show` says what differs."),
    ("supports no longer hold", "Lift the parcel and set it down where more wheels carry it."),
    ("suspects", "The cell that is suspected may be in the wrong place, or its sensors stuck."),
    ("not confirmed to be off", "Cut the motors' power."),
    ("transmit queue stays full", "Does anybody acknowledge frames, and is the bit rate right?"),
    ("too busy", "Lower the speed, or close what else runs on this machine."),
)


def advice_for(text: str) -> str | None:
    """The remedy for an event; None without one."""
    return next((advice for says, advice in _ADVICE if says in text), None)


#: A client that comes late gets so many of the last events.
KEPT = 300


def events_of(events: Iterable[Event]) -> list[dict[str, Any]]:
    """A recorded run as the page shows it."""
    return sorted(map(_shown, events), key=_time_s)


def _shown(event: Event) -> dict[str, Any]:
    more: dict[str, Any] = {"cell": event.cell, "parcel": event.parcel}
    more = {key: value for key, value in more.items() if value is not None}
    return event_of(
        event.time_s, event.kind, event.text, trouble=event.kind in ("tip", "violation"), **more
    )


#: SI units of texts, each with the unit of the page, its size, and its zeros.
_UNITS = {"m": ("mm", 1e3, 3), "m/s": ("mm/s", 1e3, 3), "rad": ("°", degrees(1.0), 2)}
_MEASURE = re.compile(r"(?<![\w.])(-?\d+(?:\.(\d+))?) (m/s|m|rad)(?![\w/²])")


def in_page_units(text: str) -> str:
    """A text with its lengths and angles in millimetres and degrees, as the page has all others.

    >>> in_page_units("at x 0.1234 m, yaw 0.5236 rad")
    'at x 123.4 mm, yaw 30.00°'
    """
    return _MEASURE.sub(_converted, text)


def _converted(measure: re.Match[str]) -> str:
    value, decimals, unit = measure.groups()
    name, factor, zeros = _UNITS[unit]
    digits = max(0, len(decimals or "") - zeros)
    space = "" if name == "°" else " "
    # Adding zero makes -0.0 zero.
    return f"{round(float(value) * factor, digits) + 0.0:.{digits}f}{space}{name}"


def event_of(
    time_s: float, kind: str, text: str, *, trouble: bool = False, **more: Any
) -> dict[str, Any]:
    """One event; what something can be done about is a trouble too."""
    advice = advice_for(text)
    shown = {"time_s": time_s, "what": kind, "text": in_page_units(text), **more}
    if advice:
        shown["advice"] = advice
    if trouble or advice:
        shown["trouble"] = True
    return shown


class EventList:
    """Events: all of them once, and the last of them for clients that come late."""

    def __init__(self) -> None:
        self._kept: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._fresh: list[dict[str, Any]] = []

    def add(self, events: Iterable[dict[str, Any]]) -> None:
        """These have happened."""
        self._fresh += events

    def take_message(self) -> list[dict[str, Any]]:
        """The message `events` with all since the last call; none where nothing has happened."""
        fresh, self._fresh = sorted(self._fresh, key=_time_s), []
        self._kept += fresh
        return [{"kind": "events", "events": fresh}] if fresh else []

    def message_of_all(self) -> dict[str, Any]:
        """The message with those that have been sent."""
        return {"kind": "events", "events": list(self._kept), "all": True}


def _time_s(event: dict[str, Any]) -> float:
    return float(event["time_s"])
