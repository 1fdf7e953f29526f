"""Brings the cells up, sends setpoints in step with SYNC, and stops all cells if one fails.

Frames and time are passed in: the simulation and a real bus drive it alike.
"""

from collections.abc import Collection, Iterator, Mapping
from functools import partial
from math import inf
from types import MappingProxyType

import numpy as np

from mdms_host.can_link.emergencies import error_text
from mdms_host.can_link.remote_cell import Handler
from mdms_host.can_link.sdo_client import Setting
from mdms_host.coordination.bring_up import BringUpCell
from mdms_host.coordination.cells import cells_of
from mdms_host.coordination.cells_control import CellsControl
from mdms_host.coordination.odometry import Odometry
from mdms_host.coordination.phase import BRING_UP, STOPPED, TRANSITIONS, Phase, Signal
from mdms_host.coordination.schedule import Schedule, Timing
from mdms_host.coordination.speed_reports import MISSED_SYNCS
from mdms_host.coordination.supervision import OTHER_HOST, Supervision, names
from mdms_host.coordination.velocity_frames import VelocityFrames
from mdms_host.coordination.watching.standings import Standings
from mdms_host.coordination.watching.watch import Watch
from mdms_host.estimation.tracker import Estimate, Parcel, Tracker
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.program import Program
from mdms_model.arrays import Floats
from mdms_model.bus_time import WATCHED_HEARTBEAT_S
from mdms_protocol import cob, nmt, pdo
from mdms_protocol.frame import Frame

_SYNC = Frame(cob.SYNC, b"")
_OVER = (Phase.FAILING, *STOPPED)
_SETTLED = (Phase.RUNNING, *STOPPED)
_ENDING = (Phase.STOPPING, Phase.FAILING)


class Coordinator:
    """A participant of the buses that runs a program on all cells of a layout.

    `fault` is the first fault, None without one; `events` is what happened, as (time [s], text);
    `troubles` are those of the events that a person should look after, though the run goes on.
    `settings` are written to every cell, `own_settings` to the cell of that number besides; all
    other stored settings must be at their defaults. Cells that steer (the program is a
    `CellsProgram`) are written their places, too; others may have any. Raises ValueError for cells
    of more wheels than the wire has axes.
    """

    def __init__(
        self,
        layout: Layout,
        program: Program | CellsProgram,
        *,
        parcels: tuple[Parcel, ...] = (),
        settings: tuple[Setting, ...] = (),
        own_settings: Mapping[int, tuple[Setting, ...]] = MappingProxyType({}),
        timing: Timing | None = None,
        host_node_id: int = cob.NODE_MAX,
    ) -> None:
        axes = len(layout.wheels)
        self.layout = layout
        self._timing = timing or Timing()
        self._velocities = VelocityFrames(layout.node_ids, axes)
        self.phase = Phase.WAITING
        self.fault: str | None = None
        self.events: list[tuple[float, str]] = []
        self.troubles: list[tuple[float, str]] = []
        by_cells = isinstance(program, CellsProgram)
        self._buses = range(layout.bus_count)
        self.cells = cells_of(
            layout,
            settings,
            own_settings,
            status_period_s=self._timing.status_period_s,
            steered_beside=host_node_id if by_cells else None,
        )
        debounce_s = tuple(cell.debounce_s for cell in self.cells)
        self.tracker = Tracker(layout, parcels, self._timing.status_period_s, debounce_s)
        self.references_m_s: Floats = np.zeros(len(layout.wheel_cells))
        self._program = program
        self._odometry = Odometry(self.cells, axes, self._velocities, self._timing)
        self._watch = Watch(self.cells, axes, program.controllers)
        self._by_cells = (
            CellsControl(self.cells, program) if isinstance(program, CellsProgram) else None
        )
        self._heartbeat_period_s = (
            WATCHED_HEARTBEAT_S if by_cells else self._timing.heartbeat_period_s
        )
        self._supervision = Supervision(self.cells, self._timing)
        self._answered: set[BringUpCell] = set()
        # What each bus brings, by its identifiers.
        self._handlers: list[dict[int, Handler]] = [{} for _ in self._buses]
        for cell in self.cells:
            self._register(cell)
        # Two hosts that began at the same instant meet here.
        self._other_host = False
        for handlers in self._handlers:
            handlers[cob.HEARTBEAT_BASE + host_node_id] = self._on_other_host
        self._alive = nmt.heartbeat(host_node_id, nmt.OPERATIONAL)
        self._now_s = 0.0
        self._phase_since_s: float | None = None
        self._schedule = Schedule()
        self._schedule.set("heartbeat", 0.0)
        self._stop_requested = False
        self._standings = Standings()

    @property
    def lost(self) -> str | None:
        """Which parcels are lost now, and since when; None without one. Who never was is not."""
        return self._standings.lost

    @property
    def stuck(self) -> str | None:
        """Why the program cannot reach its goals any more; None while it may."""
        return self._program.stuck

    @property
    def finished(self) -> bool:
        """Whether the program has reached what it is for."""
        return self._program.finished

    @property
    def endless(self) -> bool:
        """Whether the program has no end of its own."""
        return self._program.endless

    @property
    def arrived_s(self) -> Mapping[str, float]:
        """When each parcel came to its goal, of those that are there [s]."""
        return self._watch.arrived_s

    @property
    def stopped(self) -> bool:
        """Whether the array is off and nothing more is going to happen."""
        return self.phase in STOPPED

    @property
    def wake_s(self) -> float:
        """When to poll next, if no frame comes before [s]."""
        return self._schedule.wake_s

    @property
    def speeds_m_s(self) -> Floats:
        """The speeds that the cells reported last, shape (W,); NaN for one that has not."""
        frames = [cell.speeds_data for cell in self.cells]
        heard = [data is not None for data in frames]
        speeds = np.full((len(frames), len(self.references_m_s) // len(frames)), np.nan)
        if any(heard):
            actual_m_s = self._velocities.actual_m_s([data for data in frames if data is not None])
            speeds[heard] = actual_m_s.reshape(-1, speeds.shape[1])
        return speeds.ravel()

    def estimate(self, parcel: str) -> Estimate | None:
        """Where the parcel of that name is believed to be now; None if it has not been found."""
        return self.tracker.estimate(parcel, self._now_s)

    def stop(self) -> None:
        """Request an orderly end; the next poll begins it."""
        self._stop_requested = True

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """Take in a frame from a bus; what is no cell's, or cannot be decoded, does nothing."""
        handler = self._handlers[bus].get(frame.can_id)
        if handler is not None:
            handler(frame.data, now_s)

    def poll(self, now_s: float) -> list[Frame]:
        """What to send now, where there is one bus."""
        return [frame for _, frame in self.poll_buses(now_s)]

    def poll_buses(self, now_s: float) -> list[tuple[int, Frame]]:
        """What to send now, each frame with its bus."""
        self._now_s = now_s
        if self._phase_since_s is None:
            self._enter(Phase.WAITING)
        self._check()
        self._advance()
        return [*self._host_heartbeat(), *self._commands(), *self._sync(), *self._setpoints()]

    def _register(self, cell: BringUpCell) -> None:
        """Take in a cell's frames; the coordinator acts on some of them as well."""
        handlers, node_id = self._handlers[cell.bus], cell.node_id
        handlers |= cell.handlers
        handlers[cob.HEARTBEAT_BASE + node_id] = partial(self._on_heartbeat, cell)
        handlers[pdo.STATUS.can_id(node_id)] = partial(self._on_status, cell)
        handlers[pdo.ACTUAL_VELOCITY.can_id(node_id)] = partial(self._odometry.on_speeds, cell)
        handlers[cob.EMCY_BASE + node_id] = partial(self._on_emergency, cell)
        handlers[cob.SDO_RESPONSE_BASE + node_id] = partial(self._on_answer, cell)
        if self._by_cells is not None:
            on_estimate = partial(self._by_cells.on_estimate, cell)
            handlers[cob.ESTIMATE_BASE + node_id] = on_estimate

    def _on_heartbeat(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        before = cell.nmt_state
        cell.on_heartbeat(data, now_s)
        if cell.nmt_state != before:
            self._supervision.recheck()

    def _on_status(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        before = cell.drive_states
        cell.on_status(data, now_s)
        if cell.drive_states != before:
            self._supervision.recheck()
        if cell.presence is not None:
            self.tracker.on_presence(now_s, cell.number, cell.presence)
        self._schedule_commands(cell, now_s)

    def _on_emergency(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        before = set(cell.errors.items())
        cell.on_emergency(data, now_s)
        after = set(cell.errors.items())
        for error in sorted(before - after):
            self.events.append((now_s, f"{cell.name} clears emergency {error_text(*error)}"))
        for error in sorted(after - before):
            self.events.append((now_s, f"{cell.name} sends emergency {error_text(*error)}"))

    def _on_other_host(self, data: bytes, now_s: float) -> None:
        """Somebody else sends heartbeats as the host."""
        self._other_host |= nmt.decode_heartbeat(data) is not None

    def _on_answer(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        cell.on_answer(data, now_s)
        if self.phase in BRING_UP or self.phase in _ENDING:
            self._answer(cell, now_s)

    def _schedule_commands(self, cell: BringUpCell, now_s: float) -> None:
        """A cell that has answered may be ready for its next command."""
        if self.phase in BRING_UP:
            self._answer(cell, now_s)

    def _answer(self, cell: BringUpCell, now_s: float) -> None:
        self._answered.add(cell)
        self._schedule.set("answer", now_s)

    def _check(self) -> None:
        """Act on the first fault of a cell, or on a request to stop."""
        if self.phase in _OVER:
            return
        fault = self._supervision.fault(self.phase, self._now_s)
        if fault is None and self.phase == Phase.RUNNING:
            fault = self._odometry.fault()
        if self._other_host:
            self._fail(OTHER_HOST)
        elif fault:
            self._fail(fault)
        elif self._stop_requested and (self.phase, Signal.STOP) in TRANSITIONS:
            self._signal(Signal.STOP)

    def _advance(self) -> None:
        """End the phase when all cells have reached its end, or when its time limit has passed."""
        if self.phase in _SETTLED:
            return
        late = [cell for cell in self.cells if not self._done(cell)]
        waited_s = self._now_s - (self._phase_since_s or 0.0)
        if not late:
            self._conclude()
        elif self.phase in BRING_UP and waited_s >= self._timing.phase_limit_s:
            self._fail(self._supervision.late_text(self.phase, late))
        elif self.phase not in BRING_UP and waited_s >= self._timing.stop_limit_s:
            self._note(f"not confirmed to be off: {names(late)}")
            self._signal(Signal.DONE)

    def _conclude(self) -> None:
        """End a phase that all cells have reached; nothing is written to cells of other tables."""
        strangers = self._supervision.strangers_text()
        if self.phase == Phase.IDENTIFYING and strangers:
            self._fail(strangers)
        else:
            self._signal(Signal.DONE)

    def _done(self, cell: BringUpCell) -> bool:
        """Whether the phase need not wait for a cell; when stopping, nor for a silent one."""
        lost = self.phase not in BRING_UP and self._supervision.silent(cell, self._now_s)
        return lost or cell.has_reached(self.phase)

    def _host_heartbeat(self) -> Iterator[tuple[int, Frame]]:
        if self._schedule.take("heartbeat", self._now_s, self._heartbeat_period_s):
            yield from self._on_every_bus(self._alive)

    def _on_every_bus(self, frame: Frame) -> Iterator[tuple[int, Frame]]:
        return ((bus, frame) for bus in self._buses)

    def _commands(self) -> Iterator[tuple[int, Frame]]:
        """The commands that cells need in the phase: to each when it has answered, and repeated.

        Sending to all of them at every answer would crowd setpoints off the bus.
        """
        answered = self._schedule.take("answer", self._now_s, inf)
        everyone = self._schedule.take("command", self._now_s, self._timing.command_period_s)
        if not answered and not everyone:
            return
        for cell in self.cells:
            if everyone or cell in self._answered:
                for frame in cell.commands(self.phase, self._now_s):
                    yield cell.bus, frame
        self._answered.clear()
        if everyone and self._by_cells is not None and self.phase in _ENDING:
            # Behind the quick stop: wheels are to be braked, and not just switched off.
            for frame in self._by_cells.ends():
                yield from self._on_every_bus(frame)
        if self.phase in _SETTLED:
            self._schedule.cancel("command")

    def _sync(self) -> Iterator[tuple[int, Frame]]:
        if self._schedule.take("sync", self._now_s, self._timing.sync_period_s):
            self._odometry.on_sync(self._now_s)
            yield from self._on_every_bus(_SYNC)

    def _setpoints(self) -> Iterator[tuple[int, Frame]]:
        """Take in the speeds of the last SYNC, and send the setpoints for the next one.

        Cells that steer get no setpoints, but their programs.
        """
        if not self._schedule.take("setpoint", self._now_s, self._timing.sync_period_s):
            return
        self._track()
        if self._by_cells is not None:
            yield from self._pages(self._by_cells)
            return
        self.references_m_s = np.zeros(self.references_m_s.shape)
        if self.phase == Phase.RUNNING and not isinstance(self._program, CellsProgram):
            self.references_m_s = self._program_references_m_s(self._program)
        self._odometry.on_references(self.references_m_s)
        for cell, frame in zip(
            self.cells, self._velocities.targets(self.references_m_s), strict=True
        ):
            yield cell.bus, frame

    def _pages(self, by_cells: CellsControl) -> Iterator[tuple[int, Frame]]:
        """Send what cells that steer still need, and follow what they do."""
        self.references_m_s = by_cells.references_m_s
        self._odometry.on_references(self.references_m_s)
        if self.phase == Phase.RUNNING and not self._odometry.silent:
            poses = self.tracker.poses(self._schedule.next_s("sync"))
            # A doubtful place is neither sent nor compared with what cells report.
            sure = {name: poses[name] for name in poses if name not in self.tracker.doubtful}
            for frame in by_cells.frames(sure, self._now_s, self._timing.sync_period_s):
                yield from self._on_every_bus(frame)
            self._report(poses)

    def _report(self, poses: Collection[str]) -> None:
        """Report what the program has noticed, and what becomes of the parcels that are found."""
        for text in self._program.take_notices():
            self._warn(text)
        self._watch_parcels(poses)

    def _program_references_m_s(self, program: Program) -> Floats:
        """The program's references for the next SYNC; zero while no cell reports its speeds."""
        if self._odometry.silent:
            return np.zeros(self.references_m_s.shape)
        at_s = self._schedule.next_s("sync")
        beliefs = self.tracker.beliefs(at_s, self._now_s, program.near)
        references_m_s = program.references_m_s(beliefs, self._timing.sync_period_s)
        self._report(beliefs)
        return references_m_s

    def _track(self) -> None:
        """Pass the speeds of a SYNC to the tracker, at the SYNC's time, and each once only."""
        mute = self._odometry.fallen_mute()
        if mute and self.phase == Phase.RUNNING:
            self._note(f"no speeds for {MISSED_SYNCS} SYNCs: {names(mute)}")
        speeds = self._odometry.take()
        if speeds is None:
            return
        # Of a wheel that is not known nothing is expected.
        expected_m_s = np.where(speeds.known, self.references_m_s, 0.0)
        for text in self._watch.wheels(expected_m_s, speeds.speed_m_s, self._timing.sync_period_s):
            self._warn(text)
        # What does not follow its reference shows nothing of the parcel on it.
        known = speeds.known & ~self._watch.standing
        self.tracker.on_speeds(speeds.time_s, speeds.speed_m_s, known, speeds.standing)
        self._report_standings(speeds.time_s)

    def _report_standings(self, time_s: float) -> None:
        poses = self.tracker.poses(time_s)
        for text, is_trouble in self._standings.step(time_s, self.tracker.take_changes(), poses):
            (self._warn if is_trouble else self._note)(text)
        for cell, sensors in self.tracker.take_faulty():
            which = ", ".join(map(str, sensors))
            name = self.cells[cell - 1].name
            self._warn(f"{name}: presence sensors {which} contradict all others: not believed")

    def _watch_parcels(self, found: Collection[str]) -> None:
        for text in self._watch.arrivals(self._now_s):
            self._note(text)
        for text in self._watch.parcels(found, self._timing.sync_period_s):
            self._warn(text)

    def _signal(self, signal: Signal) -> None:
        self._enter(TRANSITIONS[self.phase, signal])

    def _enter(self, phase: Phase) -> None:
        self.phase, self._phase_since_s = phase, self._now_s
        self._supervision.recheck()
        self._note(phase.value)
        self._schedule.set("command", self._now_s)
        if phase == Phase.ENABLING:
            self._schedule.set("sync", self._now_s)
            self._schedule.set("setpoint", self._now_s + self._timing.sync_period_s / 2)
        elif phase in STOPPED:
            self._schedule.cancel("sync")
            self._schedule.cancel("setpoint")

    def _fail(self, text: str) -> None:
        self.fault = text
        self._note(f"fault: {text}")
        self._signal(Signal.FAULT)

    def _warn(self, text: str) -> None:
        self.troubles.append((self._now_s, text))
        self._note(text)

    def _note(self, text: str) -> None:
        self.events.append((self._now_s, text))
