"""Events as the page lists them, in the order of their times, with what can be done about each."""

from collections import deque
from collections.abc import Iterable
from typing import Any

from mdms_host.page.shown.advice import advice_for
from mdms_model.run.record import Event

#: A client that comes late gets so many of the last events.
KEPT = 300


def events_of(events: Iterable[Event]) -> list[dict[str, Any]]:
    """What a run has recorded, as the page has it."""
    return sorted(map(_shown, events), key=_time_s)


def _shown(event: Event) -> dict[str, Any]:
    more: dict[str, Any] = {"cell": event.cell, "parcel": event.parcel}
    more = {key: value for key, value in more.items() if value is not None}
    return event_of(
        event.time_s, event.kind, event.text, trouble=event.kind in ("tip", "violation"), **more
    )


def event_of(
    time_s: float, kind: str, text: str, *, trouble: bool = False, **more: Any
) -> dict[str, Any]:
    """One event; what something can be done about is a trouble too."""
    advice = advice_for(text)
    shown = {"time_s": time_s, "what": kind, "text": text, **more}
    if advice:
        shown["advice"] = advice
    if trouble or advice:
        shown["trouble"] = True
    return shown


class EventList:
    """What has happened so far: all of it once, and the last of it for whoever comes late."""

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

    def story(self) -> dict[str, Any]:
        """The message with those that have been sent."""
        return {"kind": "events", "events": list(self._kept), "all": True}


def _time_s(event: dict[str, Any]) -> float:
    return float(event["time_s"])
