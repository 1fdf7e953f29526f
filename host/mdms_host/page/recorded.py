"""A recorded run as the page sees it: the same signals, at a time that a person chooses."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdms_host.can_link.bus_log import read_buses
from mdms_host.layout import Layout
from mdms_host.page import commands
from mdms_host.page.bus_watch import KINDS, BusWatch, CellState
from mdms_host.page.commands import Command, PageRefusedError
from mdms_host.page.description import (
    NOT_FOUND,
    PHASES,
    SnapshotSignals,
    Thing,
    describe,
    planned,
    stocked,
)
from mdms_host.page.events import events_of
from mdms_host.page.flow import NO_ENDS, Ends, FlowCount, beside
from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.run.derived import goals_at, goals_given, plan_at, slip_m_s
from mdms_model.run.folder import BUS_LOG, StoredRun, bus_number
from mdms_model.run.record import Event, Record

#: Instants of a run that are shown, and of these as many that the plots have.
SHOWN_PER_S = 60.0
MOST_PLOTTED = 600
#: Rates of frames are over so long [s].
_RATES_S = 0.1
_MOST_EVENTS = 5000
_NO_GOAL = np.full(3, np.nan)


class RecordedTable:
    """A run folder, played at any speed, from any time."""

    offers: tuple[str, ...] = ("pause", "resume", "step", "speed", "seek")

    def __init__(
        self,
        run: StoredRun,
        layout: Layout,
        things: dict[str, Thing],
        ends: Ends = NO_ENDS,
    ) -> None:
        self.version = 1
        record = run.record
        self._run = run
        self._layout = layout
        self._things = things
        self._ends = ends
        self._signals = SnapshotSignals(layout, len(things), len(ends.exits))
        self._wheels = build_wheels(run.scenario)
        axes = np.arange(len(self._wheels.cell)) - self._wheels.first[self._wheels.cell]
        #: The place of each wheel among those of the layout, whose cells are all alike.
        self._wheel_places = self._wheels.cell * len(layout.wheels) + axes
        self._instants = _shown(record.time_s)
        self._times_s: Floats = record.time_s[self._instants]
        bitrate = run.scenario.wire.bitrate
        self._bus = _BusHistory(run.folder / BUS_LOG, layout, self._times_s, bitrate)
        slip = record.slip_m_s if record.slip_m_s is not None else slip_m_s(run.scenario, record)
        self._slip_m_s = slip
        self._phases = _phases(record.events, self._times_s)
        self._arrived = _arrived(record, list(things), self._times_s)
        self.duration_s = float(self._times_s[-1])
        self._comings = [each for each in record.events if each.kind in ("arrival", "exit")]
        if record.is_belief:
            # A program counts from its own beginning.
            begun = np.flatnonzero(self._phases == PHASES.index("running"))
            since_s = float(self._times_s[begun[0]]) if len(begun) else self.duration_s
            self._ends = replace(ends, since_s=since_s)
        self._history = b""
        self._shown_plan = planned({}, ())
        self._at_s = 0.0
        self._speed = 1.0
        self._paused = False
        self._last_s: float | None = None

    # Time ----------------------------------------------------------------------------------------

    def advance(self, wall_s: float) -> None:
        """It is `wall_s` by the machine's clock."""
        if self._last_s is not None and not self._paused:
            self._at_s += (wall_s - self._last_s) * self._speed
        self._last_s = wall_s
        if self._at_s >= self.duration_s:
            self._at_s, self._paused = self.duration_s, True

    # Shown ----------------------------------------------------------------------------------------

    def description(self) -> dict[str, Any]:
        """See `Table`."""
        title = self._run.scenario.title
        told = describe(
            title, self._layout, self._things, self._signals, self.offers, ends=self._ends
        )
        for name in ("wheels_m", "wheel_directions"):
            told[name] = [None] * len(told[name])
        for place, position_m, direction in zip(
            self._wheel_places.tolist(),
            self._wheels.position_m.round(6).tolist(),
            self._wheels.direction.round(6).tolist(),
            strict=True,
        ):
            told["wheels_m"][place], told["wheel_directions"][place] = position_m, direction
        return told | {"version": self.version, "recorded": True, "duration_s": self.duration_s}

    def snapshot(self, sequence: int) -> bytes:
        """See `Table`."""
        index = int(np.searchsorted(self._times_s, self._at_s, side="right")) - 1
        now = {"time": self._at_s, "speed": self._speed, "paused": [int(self._paused)]}
        return self._signals.pack(self.version, sequence, self._values(max(index, 0)) | now)

    def history(self) -> bytes:
        """See `Table`; whoever asks for it again gets the same."""
        if not self._history:
            self._history = self._packed_history()
        return self._history

    def _packed_history(self) -> bytes:
        count = len(self._times_s)
        chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_PLOTTED)).round().astype(int))
        return b"".join(
            self._signals.pack(self.version, 0, self._values(index)) for index in chosen.tolist()
        )

    def _values(self, index: int) -> dict[str, Any]:
        record, instant = self._run.record, self._instants[index]
        believed = record.estimate
        goals = goals_at(self._run.scenario, record, float(self._times_s[index]))
        shown: dict[str, Any] = {
            "time": self._times_s[index],
            "speed": self._speed,
            "real_time_factor": self._speed,
            "wheel_speed": self._by_place(record.speed_m_s[instant]),
            "wheel_reference": self._by_place(record.reference_m_s[instant]),
            "wheel_slip": self._by_place(self._slip_m_s[instant]),
            "wheel_normal": self._by_place(record.normal_n[instant]),
            "parcel_true": self._true_poses(instant),
            "parcel_goal": [goals.get(name, _NO_GOAL) for name in self._things],
            "phase": [self._phases[index]],
        }
        if believed is not None:
            shown["parcel_believed"] = believed[instant]
            found = np.isfinite(believed[instant, :, 0])
            states = np.where(found, 1 + 2 * self._arrived[index], NOT_FOUND)
            shown["parcel_state"] = stocked(states, self._things, self._ends)
        if record.identity is not None and record.state is not None:
            shown["cell_promise"] = record.identity[instant]
            shown["cell_promise_state"] = record.state[instant]
        return shown | self._flow(float(self._times_s[index])) | self._bus.values(index)

    def _by_place(self, values: Floats) -> Floats:
        """Values of the wheels for the layout's; NaN for a wheel that its cell has not."""
        placed = np.full(len(self._layout.wheel_cells), np.nan)
        placed[self._wheel_places] = values
        return placed

    def _true_poses(self, instant: Any) -> Any:
        """Under the names of beliefs, as far as parcels are alike."""
        record = self._run.record
        if record.estimate is None:
            return record.pose[instant]
        true, believed = (
            {
                name: pose
                for name, pose in zip(self._things, poses, strict=True)
                if pose[0] == pose[0]
            }
            for poses in (record.pose[instant], record.estimate[instant])
        )
        named = beside(believed, true, self._ends)
        return [named.get(name, _NO_GOAL) for name in self._things]

    def _flow(self, time_s: float) -> dict[str, Any]:
        """Parcels that have come and left by a time; nothing for a real table without any."""
        if self._run.record.is_belief and not self._comings:
            return {}
        count = FlowCount(self._ends)
        count.count([event for event in self._comings if event.time_s <= time_s])
        return count.values(time_s)

    def take_messages(self) -> list[dict[str, Any]]:
        """See `Table`: all is known from the start but which plan is in force."""
        plan = self._plan()
        if plan == self._shown_plan:
            return []
        self._shown_plan = plan
        return [plan]

    def opening_messages(self) -> list[dict[str, Any]]:
        """See `Table`."""
        events = events_of(self._run.record.events)[-_MOST_EVENTS:]
        return [{"kind": "events", "events": events, "all": True}, self._plan()]

    def _plan(self) -> dict[str, Any]:
        """The message `plan` of the time that is shown."""
        plan = plan_at(self._run.record, self._at_s)
        if plan is None:
            return planned({}, ())
        tiles = [(tile.x_m, tile.y_m, tile.side_m, tile.parcels) for tile in plan.tiles]
        return planned(plan.ways, tiles)

    # Done -----------------------------------------------------------------------------------------

    def do(self, command: Command) -> str | None:
        """See `Table`."""
        match command:
            case commands.Pause():
                self._paused = True
            case commands.Resume():
                self._at_s = 0.0 if self._at_s >= self.duration_s else self._at_s
                self._paused = False
            case commands.Step():
                self._paused = True
                self._at_s = min(self._at_s + command.duration_s, self.duration_s)
            case commands.Speed():
                self._speed = command.factor
            case commands.Seek():
                self._at_s = min(command.time_s, self.duration_s)
            case _:
                raise PageRefusedError("a recording has no such command")
        return None

    def abandon(self) -> None:
        """See `Table`: nothing moves in a recording."""


class _BusHistory:
    """The buses at given times by a bus log; empty without one."""

    def __init__(self, log: Path, layout: Layout, times_s: Floats, bitrate: int) -> None:
        self._bitrate = bitrate
        instants, cells = len(times_s), layout.cells
        self._logged = log.is_file()
        self._states = np.full((instants, cells), CellState.RUNNING, np.uint8)
        self._presence = np.zeros((instants, cells), np.uint8)
        self._rates = np.full((instants, layout.bus_count, len(KINDS)), np.nan)
        self._loads = np.full((instants, layout.bus_count), np.nan)
        if self._logged:
            self._read(log, layout, times_s)

    def values(self, index: int) -> dict[str, Any]:
        """Signals by name."""
        return {
            "cell_state": self._states[index],
            "cell_presence": self._presence[index],
            "bus_frames": self._rates[index],
            "bus_load": self._loads[index],
        }

    def _read(self, log: Path, layout: Layout, times_s: Floats) -> None:
        """Follow the log through once, and note how all is at each of the times."""
        watch = BusWatch(layout)
        frames = (
            (time_s, frame, bus)
            for time_s, frame, interface in read_buses(log)
            if (bus := bus_number(interface)) < layout.bus_count
        )
        counts = np.zeros((len(times_s), *self._rates.shape[1:]))
        bits = np.zeros(self._loads.shape)
        ahead = next(frames, None)
        for index, time_s in enumerate(times_s.tolist()):
            while ahead is not None and ahead[0] <= time_s:
                watch.on_frame(ahead[1], ahead[0], ahead[2])
                ahead = next(frames, None)
            self._states[index] = np.frombuffer(watch.states(time_s), np.uint8)
            self._presence[index] = np.frombuffer(watch.presence(time_s), np.uint8)
            counts[index], bits[index] = watch.frames, watch.bits
        before = np.searchsorted(times_s, times_s - _RATES_S).clip(0, len(times_s) - 1)
        passed_s = np.maximum(times_s - times_s[before], 1e-3)
        self._rates = (counts - counts[before]) / passed_s[:, None, None]
        self._loads = (bits - bits[before]) / passed_s[:, None] / self._bitrate


def _shown(time_s: Floats) -> NDArray[np.intp]:
    """The instants of a record that are shown: no more than are needed."""
    numbers = np.floor(time_s * SHOWN_PER_S + 1e-6)
    return np.flatnonzero(np.diff(numbers, prepend=-1.0) > 0)


def _phases(events: list[Event], times_s: Floats) -> NDArray[np.uint8]:
    """The number of the coordinator's phase at each time."""
    phases = np.zeros(len(times_s), np.uint8)
    for event in events:
        if event.kind == "coordinator" and event.detail in PHASES:
            phases[times_s >= event.time_s] = PHASES.index(event.detail)
    return phases


def _arrived(record: Record, names: list[str], times_s: Floats) -> NDArray[np.uint8]:
    """Whether each parcel has come to the goal that it has at each time, shape (T, P)."""
    arrived = np.zeros((len(times_s), len(names)), np.uint8)
    # A parcel that has come to its goal, and is given another at that instant, is on its way again.
    changes = [
        (event.time_s, 0, name)
        for event in record.events
        for name in names
        if event.detail == f"{name} has arrived"
    ]
    changes += [(time_s, 1, name) for time_s, name, _ in goals_given(record) if name in names]
    for time_s, is_goal, name in sorted(changes):
        arrived[times_s >= time_s, names.index(name)] = not is_goal
    return arrived
