"""Joins the parts of a run of the array: supervision and bring-up, belief, plan, setpoints.

Frames and time are passed in: the simulation and a real bus drive it alike.
"""

from collections.abc import Mapping
from dataclasses import astuple
from types import MappingProxyType

import numpy as np

from mdms_host.coordination.bring_up import BringUpCell, ExpectedCells
from mdms_host.coordination.control_cycle import ControlCycle
from mdms_host.coordination.frames import CellsControl, Commands, FrameRouter
from mdms_host.coordination.recovery import ArrayState, Policy, Recovery, Roster
from mdms_host.coordination.run_state import (
    HELD,
    STOPPED,
    TROUBLED,
    EventJournal,
    Phase,
    Schedule,
    Timing,
)
from mdms_host.coordination.run_state_machine import RunStateMachine
from mdms_host.coordination.supervision import Supervision
from mdms_host.coordination.wheel_speeds import Odometry, VelocityFrames
from mdms_host.estimation.tracker import Estimate, Parcel, Tracker
from mdms_host.layout import Layout
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.program import ByCells, HandlesLostCells, Program
from mdms_host.motion.safe_goals import Places, SafeGoals
from mdms_model.arrays import Floats
from mdms_model.buses import WATCHED_HEARTBEAT_S
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame

_SYNC = Frame(cob.SYNC, b"")
#: A parcel may have moved by so much while cells were out, as a standard deviation: as far as
#: reports of its edges have got lost. Its way in a time without speeds is the estimator's.
_UNSEEN_M = 0.003


class Coordinator:
    """A participant of the buses that runs a program on all cells of a layout.

    `fault` is the cause of the run's end, None as long as it goes on. `events` are pairs of time
    [s] and text; `troubles` are the events that need a person, though the run goes on. Cells that
    are not as `expected` end the run before any wheel is driven. Cells that steer (the program is a
    `ByCells`) are written their places, too; others may have any. `policy` is the reaction to cells
    that fall out of action. `centres_of_mass_m` are those of parcels that have them beside their
    origins, in their frames. Raises ValueError for cells of more wheels than the wire has axes.
    """

    def __init__(
        self,
        layout: Layout,
        program: Program | ByCells,
        *,
        parcels: tuple[Parcel, ...] = (),
        expected: ExpectedCells | None = None,
        timing: Timing | None = None,
        policy: Policy | None = None,
        centres_of_mass_m: Places = MappingProxyType({}),
    ) -> None:
        axes = len(layout.wheels)
        self.layout = layout
        self._timing = timing = timing or Timing()
        self._program = program
        self._safe_goals = SafeGoals(layout, centres_of_mass_m)
        self._journal = EventJournal()
        self._velocities = VelocityFrames(layout.node_ids, axes)
        by_cells = isinstance(program, ByCells)
        expected, period_s = expected or ExpectedCells(), timing.status_period_s
        self.cells = tuple(
            BringUpCell(number, layout, expected, status_period_s=period_s, steers=by_cells)
            for number in range(1, layout.cells + 1)
        )
        debounce_s = tuple(cell.debounce_s for cell in self.cells)
        self.tracker = Tracker(layout, parcels, timing.status_period_s, debounce_s)
        self._odometry = Odometry(self.cells, axes, self._velocities, timing)
        roster, supervision = Roster(self.cells, axes), Supervision(self.cells, timing)
        array = ArrayState(timing, self._journal, roster, supervision, self._odometry)
        self._recovery = Recovery(
            array,
            policy or Policy(),
            on_lost=self._on_lost_cells,
            on_back=lambda: self.tracker.look_again(_UNSEEN_M),
            unsure=lambda: bool(self.tracker.doubtful),
        )
        self._schedule = Schedule()
        steering = CellsControl(self.cells, program) if isinstance(program, ByCells) else None
        self._steering = steering
        self._commands = Commands(roster, self._schedule, timing.command_period_s, steering)
        self._frame_router = FrameRouter(
            array, layout.bus_count, self.tracker, self._commands, steering
        )
        self._machine = RunStateMachine(
            array,
            self._recovery,
            self._frame_router,
            on_phase=self._on_phase,
        )
        self._cycle = ControlCycle(array, program, self.tracker, self._velocities, steering)
        self._buses = range(layout.bus_count)
        self._alive = nmt.heartbeat(cob.HOST_NODE, nmt.OPERATIONAL)
        self._heartbeat_period_s = WATCHED_HEARTBEAT_S if by_cells else timing.heartbeat_period_s
        self._now_s = 0.0
        self._schedule.set("heartbeat", 0.0)

    # State of the run

    @property
    def phase(self) -> Phase:
        """The phase of the run."""
        return self._machine.phase

    @property
    def fault(self) -> str | None:
        """See above."""
        return self._machine.fault

    @property
    def events(self) -> list[tuple[float, str]]:
        """See above."""
        return self._journal.events

    def events_since(self, number: int) -> tuple[list[tuple[float, str]], int]:
        """The events that came after so many, and how many came in all: old ones are dropped."""
        return self._journal.since(number)

    @property
    def troubles(self) -> list[tuple[float, str]]:
        """See above."""
        return self._journal.troubles

    @property
    def references_m_s(self) -> Floats:
        """The references of all wheels as they were sent last, shape (W,)."""
        return self._cycle.references_m_s

    @property
    def lost(self) -> str | None:
        """The parcels that are lost now, and since when; None without one.

        Parcels that were never found are not listed.
        """
        return self._cycle.standings.lost

    @property
    def lost_cells(self) -> dict[int, str]:
        """The cells that the run does without now, by number, and why."""
        return self._recovery.lost

    @property
    def pauses(self) -> int:
        """How often all parcels have been held, for cells that were out of action."""
        return self._recovery.pauses

    @property
    def stuck(self) -> str | None:
        """Why the program cannot reach its goals any more; None while it may."""
        return self._program.stuck

    @property
    def finished(self) -> bool:
        """Whether the program has reached its aim."""
        return self._program.finished

    @property
    def endless(self) -> bool:
        """Whether the program has no end of its own."""
        return self._program.endless

    @property
    def arrived_s(self) -> Mapping[str, float]:
        """When each parcel came to its goal, of those that are there [s]."""
        return self._cycle.watch.arrived_s

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
        """The last reported speeds of all wheels, shape (W,); NaN for a cell without a report."""
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

    @property
    def program(self) -> Program | ByCells:
        """What it runs."""
        return self._program

    @property
    def goals(self) -> Mapping[str, GoalPose]:
        """The goal of each parcel that is steered to one."""
        return {name: one.goal for name, one in self._program.controllers.items()}

    @property
    def arrived(self) -> Mapping[str, GoalPose]:
        """The goals of the parcels that are there, as it believes, and knows well enough."""
        there = {name: one for name, one in self._program.controllers.items() if one.arrived}
        return {name: one.goal for name, one in there.items() if name not in self.unsure}

    @property
    def unsure(self) -> Mapping[str, str]:
        """The parcels that may be beside the goals that they have come to, and how far off."""
        return self._cycle.watch.unsure

    def set_goal(self, parcel: str, goal: GoalPose) -> None:
        """Steer a parcel to another goal from the next setpoints on.

        The parcel keeps its goal if this raises. Raises TippingError if the parcel would tip at the
        goal, or on a straight way that it takes there. Raises ValueError if the program steers no
        parcels, and KeyError for an unknown parcel.
        """
        known = self.tracker.parcels.get(parcel)
        if known is not None:
            estimate = self.estimate(parcel)
            start = None if estimate is None else np.array(astuple(estimate))
            # Programs with traffic plan no way on which a parcel tips.
            straight = not hasattr(self._program, "traffic")
            self._safe_goals.check(known, start, goal, straight=straight)
        self._program.set_goal(parcel, goal)

    # Inputs

    def stop(self) -> None:
        """Request an orderly end; the next poll begins it."""
        self._machine.stop()

    def fail(self, text: str) -> None:
        """End the run with a fault of something beside the cells; the next poll begins it."""
        self._machine.fail(text)

    def keep(self, keeps: bool) -> None:
        """Keep all parcels standing from the next poll on, or let the program move them again."""
        self._machine.keeps = keeps

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """Take in a frame from a bus.

        Frames of other nodes, and frames that cannot be decoded, do nothing.
        """
        self._frame_router.on_frame(frame, now_s, bus)

    def poll(self, now_s: float) -> list[Frame]:
        """Frames to send now, where there is one bus."""
        return [frame for _, frame in self.poll_buses(now_s)]

    def poll_buses(self, now_s: float) -> list[tuple[int, Frame]]:
        """Frames to send now, each with its bus."""
        self._now_s = now_s
        self._machine.step(now_s)
        return [
            (each, frame)
            for bus, frame in self._frames(now_s)
            for each in (self._buses if bus is None else (bus,))
        ]

    def _frames(self, now_s: float) -> list[tuple[int | None, Frame]]:
        """Frames to send now, each with its bus, None for all buses."""
        frames: list[tuple[int | None, Frame]] = []
        sync_period_s = self._timing.sync_period_s
        if self._schedule.take("heartbeat", now_s, self._heartbeat_period_s):
            frames.append((None, self._alive))
        frames += self._commands.due(now_s)
        if self._schedule.take("sync", now_s, sync_period_s):
            self._odometry.reports.on_sync(now_s)
            frames.append((None, _SYNC))
        if self._schedule.take("setpoint", now_s, sync_period_s):
            next_s = self._schedule.next_s("sync")
            frames += self._cycle.frames(self._machine.phase, now_s, next_s)
        return frames

    # Consequences

    def _on_phase(self, before: Phase, phase: Phase, now_s: float) -> None:
        """A phase of the run begins."""
        self._commands.on_phase(phase, now_s)
        if phase in TROUBLED:
            self.tracker.look_away()
        elif before in TROUBLED:
            self.tracker.look_again(_UNSEEN_M)
        if phase == Phase.ENABLING:
            self._schedule.set("sync", now_s)
            self._schedule.set("setpoint", now_s + self._timing.sync_period_s / 2)
        elif phase in STOPPED:
            self._schedule.cancel("sync")
            self._schedule.cancel("setpoint")
        elif phase is Phase.RUNNING and before in HELD and self._steering is not None:
            self._steering.begin_again()

    def _on_lost_cells(self, numbers: frozenset[int]) -> None:
        """The run does without these cells (from 1), and without no others."""
        self.tracker.ignore_cells(numbers)
        if isinstance(self._program, HandlesLostCells):
            self._program.on_lost_cells(numbers)
