"""The coordinator's view of a run, sampled for the record: on hardware the truth is unknown."""

from collections import deque
from collections.abc import Callable, Iterable

import numpy as np

from mdms_host.can_link.recent import Recent
from mdms_host.coordination.coordinator import Coordinator
from mdms_model.arrays import Floats
from mdms_model.buses import Addresses
from mdms_model.run.frame_readers import CellReports, PresenceReader, without_reports
from mdms_model.run.record import MOST_SAMPLES, Contact, Event, History, Record, leaving
from mdms_protocol.codecs.frame import Frame

#: As often as the simulation samples.
SAMPLE_S = 0.01
#: Of a run of weeks, parcels that came and left lately.
_MOST_EVENTS = 50_000


class Recorder:
    """A participant that passes everything to a coordinator and back, and keeps a record of it.

    `estimates` returns the poses that the coordinator believes the parcels to have, shape (P, 3),
    NaN where unknown. `log_frame(frame, time_s, bus)` is called for every frame, received or sent,
    and `look(time_s)` whenever a sample is due. `recent`, if given, keeps the last minute. `flow`
    returns the parcels that came or left since its last call, each with its exit (None: it came).
    """

    def __init__(
        self,
        coordinator: Coordinator,
        estimates: Callable[[], Floats],
        log_frame: Callable[[Frame, float, int], object] = lambda _frame, _time_s, _bus: None,
        *,
        look: Callable[[float], object] = lambda _time_s: None,
        recent: Recent | None = None,
        flow: Callable[[], Iterable[tuple[str, str | None]]] = tuple,
    ) -> None:
        self._coordinator = coordinator
        self._estimates = estimates
        self._log_frame = log_frame
        self._look = look
        self._recent = recent
        self._flow = flow
        self._events: deque[Event] = deque(maxlen=_MOST_EVENTS)
        self._history = History(MOST_SAMPLES)
        layout = coordinator.layout
        addresses = Addresses(layout.buses, layout.node_ids)
        self._reports = CellReports(layout.cell_positions_m, addresses)
        self._presence = PresenceReader(addresses)
        self._due_s = -np.inf

    @property
    def wake_s(self) -> float:
        """When to poll next, if no frame comes before [s]."""
        return self._coordinator.wake_s

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """A frame was on a bus."""
        self._log_frame(frame, now_s, bus)
        if self._recent is not None:
            self._recent.on_received(frame, now_s, bus)
        if frame.can_id in self._reports.cells[bus]:
            self._reports.on_frame(bus, frame, now_s)
        elif frame.can_id in self._presence.cells[bus]:
            self._presence.on_frame(bus, frame, round(now_s * 1e9))
        self._coordinator.on_frame(frame, now_s, bus)

    def poll(self, now_s: float) -> Iterable[Frame]:
        """Frames that the coordinator sends now, where there is one bus."""
        return [frame for _, frame in self.poll_buses(now_s)]

    def poll_buses(self, now_s: float) -> Iterable[tuple[int, Frame]]:
        """Frames that the coordinator sends now; a sample is taken afterwards, if one is due."""
        recent = self._recent
        if recent is not None:
            recent.on_cycle(max(0.0, now_s - self._coordinator.wake_s))
        frames = self._coordinator.poll_buses(now_s)
        self._events += [_flow_event(now_s, *each) for each in self._flow()]
        for bus, frame in frames:
            self._log_frame(frame, now_s, bus)
            if recent is not None:
                recent.on_sent(frame, now_s, bus)
        if recent is not None and recent.wants_belief(now_s):
            recent.believe(now_s, self._estimates())
        if now_s >= self._due_s:
            # Samples that a busy machine has missed are not made up for.
            self._due_s = max(self._due_s + SAMPLE_S, now_s)
            self._look(now_s)
            self._sample(now_s)
        return frames

    def record(self, incidents: Iterable[tuple[float, str]] = ()) -> Record:
        """The record so far, with the coordinator's events and the link's incidents."""
        events = [Event(time_s, "coordinator", text) for time_s, text in self._coordinator.events]
        events += [Event(time_s, "link", text) for time_s, text in incidents]
        events += self._events
        history = self._history.copy()
        if not len(history.time_s):
            self._sample(0.0)
            history = self._history.copy()
        columns = history.columns()
        if not self._reports.any:
            columns = without_reports(columns)
        poses, wheels = columns["estimate"], columns["reference_m_s"]
        nowhere, nothing = np.full_like(poses, np.nan), np.full_like(wheels, np.nan)
        return Record(
            time_s=history.time_s,
            pose=nowhere,
            twist=nowhere,
            voltage_v=nothing,
            normal_n=nothing,
            force_n=nothing,
            contact=np.full(wheels.shape, Contact.UNKNOWN, np.int8),
            events=sorted(events, key=lambda event: event.time_s),
            **columns,
        )

    def _sample(self, now_s: float) -> None:
        if self._history.takes():
            self._history.append(
                now_s,
                reference_m_s=self._coordinator.references_m_s.copy(),
                speed_m_s=self._coordinator.speeds_m_s,
                estimate=self._estimates(),
                presence=self._presence.bits,
                **self._reports.sample(now_s),
            )


def _flow_event(time_s: float, parcel: str, exit_name: str | None) -> Event:
    """A parcel came, or left by the exit that it was steered to."""
    if exit_name is None:
        return Event(time_s, "arrival", "came, as sensors show", parcel=parcel)
    return leaving(time_s, parcel, exit_name, wrong=False)
