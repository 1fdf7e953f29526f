"""A table with a host that steers it, for the page, and a person's orders for its parcels.

A person gives parcels goals and names. A parcel follows a goal that is dragged only as long as
there is a hand on it.
"""

from collections.abc import Callable
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import BRING_UP
from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.goal import GoalPose
from mdms_host.page import commands
from mdms_host.page.bus_watch import KINDS, BusRates, BusWatch
from mdms_host.page.cell_objects import ObjectReader
from mdms_host.page.commands import Command, PageRefusedError
from mdms_host.page.description import (
    OTHER_HOST,
    PHASES,
    SnapshotSignals,
    believed_signals,
    describe,
    plan_of,
    sized,
    stocked,
    things_of,
)
from mdms_host.page.events import EventList, event_of
from mdms_host.page.flow import believed_flow, ends_of
from mdms_host.page.run_slot import RunSlot
from mdms_host.programs.program import TableProgram
from mdms_host.programs.table_parcel import ProgramError
from mdms_model.arrays import Floats
from mdms_model.scenario.scenario import Scenario

#: A goal that is dragged is sent again at least this often by a page that is there [s].
HELD_S = 1.0


class ParcelsByHand:
    """Sets goals of a coordinator's parcels, and names them; `wall_s` is the machine's time."""

    def __init__(self, wall_s: Callable[[], float]) -> None:
        self._wall_s = wall_s
        #: When each goal that is dragged came last, and whose parcels these are.
        self._held: dict[str, float] = {}
        self._holder: Coordinator | None = None

    def set_goal(self, coordinator: Coordinator, command: commands.Goal) -> None:
        """Steer a parcel there from now on. Raises `PageRefusedError`.

        A parcel that is dragged beyond its reach is held at its goal before. If it is let go of
        there, it stays where it is.
        """
        self._leave_others(coordinator)
        if command.held and command.parcel in self._held:
            self._held[command.parcel] = self._wall_s()
        goal = _goal_of(coordinator, command)
        try:
            coordinator.set_goal(command.parcel, goal)
        except KeyError:
            raise PageRefusedError(_not_steered(coordinator, command.parcel)) from None
        except ValueError as error:
            stays = self._dropped(coordinator, command)
            raise PageRefusedError(f"{error}{stays}") from None
        self._held.pop(command.parcel, None)
        if command.held:
            self._held[command.parcel] = self._wall_s()

    def _dropped(self, coordinator: Coordinator, command: commands.Goal) -> str:
        """Have a parcel stay that was dragged here and is let go of at a goal that is refused."""
        if command.held or self._held.pop(command.parcel, None) is None:
            return ""
        stays = _stay(coordinator, command.parcel)
        return f"; {command.parcel} stays where it is" if stays else ""

    def let_go(self, coordinator: Coordinator | None) -> list[str]:
        """Have parcels stay whose goals nobody holds any more; returns their names."""
        self._leave_others(coordinator)
        now_s = self._wall_s()
        gone = [name for name, held_s in self._held.items() if now_s - held_s > HELD_S]
        if coordinator is None or coordinator.stopped:
            stay, over = [], gone
        else:
            stay = [name for name in gone if _stay(coordinator, name)]
            # One that is lost stays where it is found.
            over = [name for name in gone if name in stay or name not in coordinator.goals]
        for name in over:
            del self._held[name]
        return stay

    def _leave_others(self, coordinator: Coordinator | None) -> None:
        """A hand that dragged a goal of a program before has nothing to do with this one."""
        if coordinator is not self._holder:
            self._held.clear()
            self._holder = coordinator

    def name(self, coordinator: Coordinator, command: commands.Name) -> None:
        """Take an unknown thing for a parcel. Raises `PageRefusedError`."""
        parcel = Parcel(
            command.name,
            command.length_m,
            command.width_m,
            shape=command.shape,
            spread_m=command.spread_m,
        )
        try:
            coordinator.tracker.name(command.parcel, parcel)
        except KeyError:
            raise PageRefusedError(f"nothing unknown is called {command.parcel!r:.60}") from None
        except ValueError as error:
            raise PageRefusedError(str(error)) from None


def _not_steered(coordinator: Coordinator, name: str) -> str:
    """Why the program that runs steers nothing of this name."""
    if name in coordinator.tracker.unknown:
        return f"{name} is unknown, and is not steered; give it a name first"
    if name not in coordinator.tracker.parcels:
        names = ", ".join(sorted(coordinator.tracker.parcels)) or "none"
        return f"there is no parcel {name!r:.60}; there are: {names}"
    if coordinator.estimate(name) is None:
        return f"{name} has not been found yet; ask again when it has"
    return f"the program that runs does not steer {name}"


def _goal_of(coordinator: Coordinator, command: commands.Goal) -> GoalPose:
    """The goal, as exact as the parcel's own; a disc's turn is seen by no sensor."""
    before = coordinator.goals.get(command.parcel, GoalPose(0.0, 0.0))
    parcel = coordinator.tracker.parcels.get(command.parcel)
    turned = parcel is None or parcel.shape != "disc"
    yaw_rad = command.yaw_rad if turned else None
    return replace(before, x_m=command.x_m, y_m=command.y_m, yaw_rad=yaw_rad)


def _stay(coordinator: Coordinator, name: str) -> bool:
    """Have a parcel stay where it is believed to be; returns whether it can be."""
    estimate = coordinator.estimate(name) if name in coordinator.tracker.parcels else None
    if estimate is None or name not in coordinator.goals:
        return False
    here = commands.Goal(name, estimate.x_m, estimate.y_m, estimate.yaw_rad)
    try:
        coordinator.set_goal(name, _goal_of(coordinator, here))
    except (KeyError, ValueError):
        # A parcel that cannot be given a goal does not go on to its present one.
        coordinator.stop()
    return True


#: Ways and tiles are looked at so often [s].
_PLAN_S = 0.25
#: A stop that is asked for again is noted again after so long [s].
_AGAIN_S = 1.0
_GONE = (
    "the CAN device is gone, so no cell gets it: cut the motors' power. It is sent once the device "
    "is there again"
)
#: With these a person takes a run over.
_TAKES_OVER = (commands.Goal, commands.Start, commands.Stop, commands.StopAll)


class LiveTable:
    """Composed of the traffic on the buses (`watch`) and the run in the host's `slot`.

    `now_s` returns the table's time. `parcels` are those that the host is given.
    `report(time_s, kind, text)` is called for events. `error_frames` counts those of the only bus,
    where somebody does.
    """

    offers: tuple[str, ...] = (
        *("goal", "name", "start", "signal", "stop", "stop_all", "read_objects"),
    )

    def __init__(
        self,
        scenario: Scenario,
        layout: Layout,
        parcels: tuple[Parcel, ...],
        *,
        slot: RunSlot,
        watch: BusWatch,
        now_s: Callable[[], float],
    ) -> None:
        self.report: Callable[[float, str, str], object] = lambda _time_s, _kind, _text: None
        self.error_frames: Callable[[], int] | None = None
        self.version = 1
        #: The run that a person has started, steered or stopped here last.
        self.taken_over: Coordinator | None = None
        self._title = scenario.title
        self._bitrate = scenario.wire.bitrate
        self._layout = layout
        self._told = parcels
        self._things = things_of(parcels, None)
        self._slot = slot
        self._watch = watch
        self._now_s = now_s
        self._ends = ends_of(scenario, parcels)
        self._signals = self._signals_of(len(parcels))
        self._new_messages: list[dict[str, Any]] = []
        self._events = EventList()
        self._line: dict[str, Any] | None = None
        self._stopped_s = -inf
        self._reported: tuple[Coordinator | None, int] = (None, 0)
        self._plan = plan_of(None)
        self._planned_s = -inf
        self._rates = BusRates(layout.bus_count, len(KINDS))
        self._jitter_s = 0.0
        self._by_hand = ParcelsByHand(now_s)

    # What is shown

    def description(self) -> dict[str, Any]:
        """See `Table`."""
        return describe(
            self._title, self._layout, self._things, self._signals, self.offers, ends=self._ends
        ) | {"version": self.version}

    def _look_for_plans(self) -> None:
        """Ways and tiles, some times a second: they are many, and change as parcels move."""
        now_s = self._now_s()
        if not 0.0 <= now_s - self._planned_s < _PLAN_S:
            self._planned_s = now_s
            plan = plan_of(self._slot.coordinator)
            if plan != self._plan:
                self._plan = plan
                self._new_messages.append(plan)

    def _look_for_things(self) -> None:
        """Parcels come and go, and with them the shape of a snapshot."""
        things = things_of(self._told, self._slot.coordinator)
        if things != self._things:
            self._things = sized(things, self._slot.coordinator)
            self._signals = self._signals_of(len(things))
            self.version += 1

    def _signals_of(self, parcels: int) -> SnapshotSignals:
        return SnapshotSignals(self._layout, parcels, len(self._ends.exits))

    def snapshot(self, sequence: int) -> bytes:
        """See `Table`."""
        return self._signals.pack(self.version, sequence, self.values())

    def values(self) -> dict[str, Any]:
        """The signals by name, as far as they are known."""
        now_s, coordinator, watch = self._now_s(), self._slot.coordinator, self._watch
        errors = self.errors()
        self._rates.count(now_s, self._watch.frames, self.busy_s(), errors)
        identity, promise = watch.promises(now_s)
        jitter_s, self._jitter_s = self._jitter_s, 0.0
        values = {
            "time": now_s,
            "speed": 1.0,
            "real_time_factor": 1.0,
            "jitter": jitter_s,
            "bus_load": self._rates.loads,
            "bus_frames": self._rates.frames_per_s,
            "bus_errors": errors,
            "bus_error_rate": self._rates.errors_per_s,
            "wheel_speed": watch.speeds_m_s(now_s),
            "wheel_reference": watch.references_m_s,
            "cell_state": np.frombuffer(watch.states(now_s), np.uint8),
            "cell_presence": np.frombuffer(watch.presence(now_s), np.uint8),
            "cell_promise": identity,
            "cell_promise_state": promise,
        }
        if coordinator is not None:
            values |= believed_signals(self._things, coordinator)
            values |= believed_flow(self._ends, coordinator)
        nothing = np.zeros(len(self._things), np.uint8)
        states = values.get("parcel_state", nothing)
        values["parcel_state"] = stocked(states, self._things, self._ends)
        if self._slot.beside_other_host and not self._slot.busy:
            values["phase"] = [PHASES.index(OTHER_HOST)]
        return values

    def on_cycle(self, late_s: float) -> None:
        """A cycle was so late."""
        self._jitter_s = max(self._jitter_s, late_s)

    def busy_s(self) -> Any:
        """How long each bus has been busy; here as if every frame had the most stuff bits."""
        return np.array(self._watch.bits) / self._bitrate

    def errors(self) -> Floats:
        """How many error frames each bus has had, NaN where that is not known."""
        counted = np.full(self._layout.bus_count, np.nan)
        if self.error_frames is not None and len(counted) == 1:
            counted[0] = self.error_frames()
        return counted

    def history(self) -> bytes:
        """See `Table`: past messages are with the clients of that time."""
        return b""

    # What has happened

    def note(
        self, kind: str, text: str, time_s: float | None = None, *, trouble: bool = False
    ) -> None:
        """Something has happened."""
        time_s = self._now_s() if time_s is None else time_s
        self.add_events([event_of(time_s, kind, text, trouble=trouble)])

    def show_line(self, shown: dict[str, Any]) -> None:
        """The table is a machine of a line, and stands like this."""
        message = {"kind": "line", **shown}
        if message != self._line:
            self._line = message
            self._new_messages.append(message)

    def add_events(self, events: list[dict[str, Any]]) -> None:
        """These have happened."""
        for event in events:
            self.report(event["time_s"], event["what"], event["text"])
        self._events.add(events)

    def take_messages(self) -> list[dict[str, Any]]:
        """See `Table`."""
        for name in self._by_hand.let_go(self._slot.coordinator):
            self.note("page", f"{name} stays where it is: the hand that dragged its goal is gone")
        self._look()
        self._look_for_things()
        self._look_for_plans()
        messages, self._new_messages = self._new_messages, []
        return messages + self._events.take_message()

    def opening_messages(self) -> list[dict[str, Any]]:
        """See `Table`."""
        return [self._events.message_of_all(), self._plan] + ([self._line] if self._line else [])

    def _look(self) -> None:
        """Note what coordinator and reader have reported since the last call."""
        coordinator, reader = self._slot.coordinator, self._slot.reader
        if coordinator is not None:
            last, reported = self._reported
            events, reported = coordinator.events_since(reported if last is coordinator else 0)
            troubles = {text for _, text in coordinator.troubles} if events else set()
            for time_s, text in events:
                trouble = text in troubles or text.startswith("fault")
                self.note("coordinator", text, time_s, trouble=trouble)
            self._reported = coordinator, reported
        if reader is not None:
            rows = reader.take_rows()
            if rows or reader.over:
                message = {"kind": "objects", "cell": reader.cell, "rows": rows}
                self._new_messages.append(message | {"over": reader.over})
            if reader.over:
                self._slot.reader = None

    # What is done

    def do(self, command: Command) -> str | None:
        """See `Table`."""
        match command:
            case commands.Goal():
                self._by_hand.set_goal(self._running(), command)
            case commands.Name():
                self._by_hand.name(self._running(), command)
            case commands.Start():
                self._slot.start()
                self.note("page", "the program is started")
            case commands.Signal():
                self._send_signal(command)
            case commands.Stop():
                self._slot.stop()
                self.note("page", "the program is stopped")
            case commands.StopAll():
                self._slot.stop_all()
                self._note_stop()
                if not self._slot.is_there():
                    raise PageRefusedError(_GONE)
            case commands.ReadObjects():
                self._read(command.cell)
            case _:
                raise PageRefusedError("this table has no such command")
        if isinstance(command, _TAKES_OVER):
            self.taken_over = self._slot.coordinator
        return None

    def abandon(self) -> None:
        """See `Table`: a program is watched by whoever started the command, and goes on."""

    def _running(self) -> Coordinator:
        """The coordinator of the program that runs. Raises `PageRefusedError`."""
        coordinator = self._slot.coordinator
        if coordinator is None or not self._slot.busy:
            raise PageRefusedError("no program runs; start one first")
        return coordinator

    def _send_signal(self, command: commands.Signal) -> None:
        program = self._running().program
        if not isinstance(program, TableProgram) or program.keeps_goals:
            raise PageRefusedError("the program that runs has no tasks, and takes no signals")
        try:
            program.table.send_signal(command.name, command.value)
        except ProgramError as error:
            raise PageRefusedError(str(error)) from None
        self.note("page", f"signal {command.name!r:.60}: {command.value!r:.60}")

    def _note_stop(self) -> None:
        """One who presses a button for long does not push all other events out."""
        now_s = self._now_s()
        if not 0.0 <= now_s - self._stopped_s < _AGAIN_S:
            self._stopped_s = now_s
            self.note("page", "stop all")

    def _read(self, cell: int) -> None:
        coordinator = self._slot.coordinator
        if not 1 <= cell <= self._layout.cells:
            raise PageRefusedError(f"there is no cell {cell}; the table has {self._layout.cells}")
        if coordinator is not None and coordinator.phase in BRING_UP:
            raise PageRefusedError("the cells are being brought up; ask again when they run")
        if self._slot.others_ask:
            raise PageRefusedError(
                "somebody else reads or writes settings just now; ask again later"
            )
        places = self._layout
        self._slot.reader = ObjectReader(cell, places.node_ids[cell - 1], places.buses[cell - 1])
