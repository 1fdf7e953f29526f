"""The machine: the state machine of PackML joined to the run of a table, its orders and figures.

`step` is called in the thread that drives the table. Parcels are kept standing in every state but
Execute. A run of the table begins with Reset and ends with Stop, Abort or a fault.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from math import inf
from typing import Any, Generic, TypeVar

import numpy as np

from mdms_host.commissioning.doctor.findings import KINDS
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import TROUBLED, Phase
from mdms_host.line.packml import (
    DONE,
    MOVES,
    TRANSITIONS,
    Command,
    CommandRefusedError,
    Mode,
    State,
    StateMachine,
)
from mdms_host.page.commands import PageRefusedError
from mdms_host.page.run_slot import RunSlot
from mdms_host.programs.program import TableProgram
from mdms_host.programs.table_orders import Report, TableOrders, order_of
from mdms_host.programs.table_parcel import ProgramError

Job = TypeVar("Job")
Made = TypeVar("Made")
#: Without a heartbeat of the client that started it for so long, the machine is suspended [s].
HEARTBEAT_LIMIT_S = 1.0
#: No parcel gets on for so long behind a full exit, or none comes for so long [s].
BLOCKED_S = 5.0
STARVED_S = 30.0
#: Wheels stand below this speed [m/s]. Reports of wheels at rest go up to 0.007 m/s, by the steps
#: of their encoders, and on a large table one of them always does.
_STANDS_M_S = 0.015
#: A run that comes up or stops takes no longer, or is aborted [s].
_ACTING_LIMIT_S = 30.0

#: A page shows so many orders.
_SHOWN_ORDERS = 30

_RESTS = (State.HOLDING, State.SUSPENDING, State.COMPLETING)
_GOES_ON = (State.STARTING, State.UNHOLDING, State.UNSUSPENDING)
_ENDS = (State.STOPPING, State.ABORTING, State.CLEARING)
_WITHOUT_RUN = (State.STOPPED, State.COMPLETED, State.ABORTED, *_ENDS)
#: Reasons of Suspended that pass by themselves.
_BLOCKED = "no parcel can go on; full exits: {exits}"
_STARVED = "no parcel comes"
_CURE_ABORTED = "run `mdms doctor`, mend its findings, then Clear and Reset"
_CAUSE_COMMANDED, _CURE_COMMANDED = "a client's command", "Clear and Reset"
#: A run has the bus then, so no doctor may look at the cells.
_CURE_HELD = "mend it, then Unhold (or Stop)"
_CURE_IDLE = "mend it; Start is refused until then"


class Recipes(Generic[Job]):
    """The recipes of a line: jobs with their parameters, by name. The first is `chosen` at first.

    Every run that begins takes the chosen one.
    """

    def __init__(self, jobs: Mapping[str, Job]) -> None:
        self.jobs = jobs
        self.names = tuple(jobs)
        self.chosen = self.names[0]
        #: The recipe of the present run, or of the last one.
        self.running = self.names[0]

    @property
    def first(self) -> Job:
        """The job of the first recipe."""
        return self.jobs[self.names[0]]

    def begin(self) -> Job:
        """The chosen job, for the run that begins.

        It is the first one if that was chosen before, and is not allowed now: so the machine
        reaches Idle, where another is chosen.
        """
        self.running = self.chosen if self.chosen in self.jobs else self.names[0]
        return self.jobs[self.running]

    def starter(self, make: Callable[[Job], Made]) -> Callable[[], Made]:
        """A function that makes what runs the chosen job, each time anew.

        The first of each job is made now, while nobody waits: a fresh installation compiles.
        """
        ready = {name: make(job) for name, job in self.jobs.items()}

        def start() -> Made:
            job = self.begin()
            return ready.pop(self.running, None) or make(job)

        return start

    def check_chosen(self) -> None:
        """Raises `CommandRefusedError` if the recipe chosen before is not allowed now."""
        if self.chosen not in self.jobs:
            raise CommandRefusedError(
                f"the recipe {self.chosen!r:.40} was chosen before, but is not allowed now; "
                f"choose one of these in Idle: {', '.join(self.names)}"
            )


@dataclass(slots=True)
class Figures:
    """The production so far: parcels in, out by exit, lost, and rejected.

    Those that are lost are rejected too, like PackML's defective products.
    """

    parcels_in: int = 0
    parcels_lost: int = 0
    parcels_rejected: int = 0
    out: dict[str, int] = field(default_factory=dict)

    @property
    def parcels_out(self) -> int:
        """Parcels that have left by any exit."""
        return sum(self.out.values())

    @property
    def parcels_remaining(self) -> int:
        """Parcels that have come, and neither left nor been lost."""
        return self.parcels_in - self.parcels_out - self.parcels_lost

    def count(self, report: Report) -> None:
        """A parcel has come, left or been lost."""
        self.parcels_rejected += report.rejected
        match report.event:
            case "found":
                self.parcels_in += report.new
            case "withdrawn":
                self.parcels_in -= report.new
            case "lost":
                self.parcels_lost += 1
            case "left":
                self.out[report.exit] = self.out.get(report.exit, 0) + 1


def effectiveness(
    machine: StateMachine, figures: Figures, now_s: float, ideal_per_hour: float
) -> dict[str, float]:
    """The three factors of OEE, by PackML's tags; 0 where nothing is known yet.

    Availability is the time in Execute over that in all states but Stopped. Performance is the
    rate in Execute over the ideal one. Quality is the share of parcels that were not rejected.
    """
    execute_s = machine.in_state_s(State.EXECUTE, now_s)
    planned_s = sum(machine.in_state_s(each, now_s) for each in State if each != State.STOPPED)
    per_hour = 3600.0 * figures.parcels_out / execute_s if execute_s else 0.0
    processed = figures.parcels_out + figures.parcels_lost
    good = processed - figures.parcels_rejected
    return {
        "parcels_per_hour": per_hour,
        "availability": execute_s / planned_s if planned_s else 0.0,
        "performance": per_hour / ideal_per_hour if ideal_per_hour else 0.0,
        "quality": good / processed if processed else 0.0,
    }


class Machine:
    """A table in a line; `now_s` is the machine's time. `slot` is the host's place at the table.

    `on_report` gets every report on a parcel. `exits` are the table's exits by name. The slot
    makes its runs by the chosen one of `recipes`.
    """

    def __init__(
        self,
        slot: RunSlot,
        exits: tuple[str, ...],
        now_s: Callable[[], float],
        on_report: Callable[[Report], object],
        recipes: Recipes[Any],
    ) -> None:
        self.exits = exits
        self.recipes = recipes
        self.orders = TableOrders()
        self.figures = Figures()
        self.ideal_per_hour = 0.0
        self.states = StateMachine(since_s=now_s())
        self._slot = slot
        slot.refusal = self._refusal
        self._now_s = now_s
        self._on_report = on_report
        self._beats_s: dict[str, float] = {}
        #: The client, by its protocol, whose heartbeat the machine needs to move anything.
        self._in_control = ""
        self._stalled_s: dict[str, float] = {}
        self._passing = ""
        #: Why it is held, if not by a command alone.
        self._trouble = ""
        #: Whether the last Abort was a command, and no fault.
        self._abort_commanded = False
        self._run: Coordinator | None = None
        #: The run that comes to its end now, in a state that has none.
        self._ending: Coordinator | None = None
        #: The slot's count of stops since the run is replaced.
        self._stops: int | None = None
        #: Identities that go over from that run to the one in its place.
        self._passed_on: dict[str, str] | None = None

    # From outside --------------------------------------------------------------------------------

    def command(self, command: Command, by: str) -> None:
        """Carry out a command of a client. Raises `CommandRefusedError`."""
        now_s = self._now_s()
        self.states.after(command)
        if command in MOVES and not self._beats(by, now_s):
            raise CommandRefusedError(
                f"{command.name.capitalize()} is not possible without a heartbeat of the client: "
                f"change it at least every {HEARTBEAT_LIMIT_S:g} s"
            )
        if command is Command.RESET and self._slot.busy:
            raise CommandRefusedError("the table is still stopping; give Reset again")
        if command is Command.START:
            self.recipes.check_chosen()
        if command in MOVES and self._run is not None and self._run.phase in TROUBLED:
            raise CommandRefusedError(
                f"{self._run.troubles[-1][1]}; give {command.name.capitalize()} when it is back"
            )
        self._on(command, f"{command.name.capitalize()} by {by}")
        self._abort_commanded = command is Command.ABORT
        if command in MOVES:
            self._in_control = by
        self._passing = self._trouble = ""

    def beat(self, by: str, age_s: float = 0.0) -> None:
        """A client lives, or did so before the time that its heartbeat was on its way."""
        self._beats_s[by] = max(self._beats_s.get(by, -inf), self._now_s() - age_s)

    def do(self, name: str, values: dict[str, Any]) -> None:
        """A request of a client by name. Raises `CommandRefusedError` and ProgramError."""
        match name:
            case "beat":
                self.beat(values["by"], values["age_s"])
            case "command":
                self.command(Command(values["command"]), values["by"])
            case "mode":
                self.states.change_mode(Mode(values["mode"]))
            case "order" | "in_doubt" | "cancel":
                self._do_with_order(name, values)
            case "coming":
                self.orders.expect(values["parcel"], values.get("kind", ""))
                self._tell("parcel coming", values["parcel"])
            case "not_coming":
                self.orders.expect_no_more(values["parcel"])
                self._tell("parcel not coming", values["parcel"])
            case "exit":
                self._set_exit(values["exit"], values["full"])
            case "recipe":
                self._choose(values["recipe"])
            case "chosen":
                self.recipes.chosen = values["recipe"]
            case "ideal":
                self.ideal_per_hour = values["per_hour"]
            case "restore":
                # The book may be of a later version.
                kept = {each.name for each in fields(Figures)} & values["figures"].keys()
                self.figures = Figures(**{name: values["figures"][name] for name in kept})
                spent = values["spent_s"].items()
                self.states.spent_s = {State(int(state)): spent_s for state, spent_s in spent}
                self.states.reason = values["reason"]
                # Nobody looked while there was no host.
                self.orders.was_clear = False
                self.orders.remaining = self.figures.parcels_remaining
            case _:
                raise CommandRefusedError(f"there is no request {name!r:.40}")

    def _do_with_order(self, name: str, values: dict[str, Any]) -> None:
        if name == "order":
            self.orders.give(order_of(values["order"]))
        elif name == "in_doubt":
            order = order_of(values["order"])
            self.orders.in_doubt[order.key] = order
        else:
            doubtful = self.orders.in_doubt.pop(values["key"], None)
            if doubtful is None and not self.orders.cancel(values["key"]):
                raise ProgramError(
                    f"order {values['key']} is under way, or over: it can be cancelled in Idle, "
                    "and while its parcel waits before a full exit; else hold or stop"
                )

    def _set_exit(self, name: str, full: bool) -> None:
        if name not in self.exits:
            there = ", ".join(self.exits) or "none"
            raise CommandRefusedError(f"no exit {name!r:.40}; there are: {there}")
        if full != (name in self.orders.full):
            self._tell("exit full" if full else "exit free", name)
        (self.orders.full.add if full else self.orders.full.discard)(name)

    def _tell(self, signal: str, value: str) -> None:
        """The program that runs gets this signal of the plant."""
        if self._run is not None and isinstance(self._run.program, TableProgram):
            self._run.program.driver.receive(signal, value)

    def _choose(self, name: str) -> None:
        """Start is by this recipe: it replaces the run of Idle, which has moved nothing."""
        if name not in self.recipes.names:
            there = ", ".join(self.recipes.names)
            raise CommandRefusedError(f"no recipe {name!r:.40}; there are: {there}")
        if name != self.recipes.chosen and self.states.state is not State.IDLE:
            state = self.states.state.name.capitalize()
            raise CommandRefusedError(f"a recipe is not chosen in {state}, but in Idle alone")
        self.recipes.chosen = name

    # In the thread that drives the table ---------------------------------------------------------

    def on_suspended(self, for_s: float) -> None:
        """The host stood still for so long [s]: parcels may lie elsewhere, so a run is aborted."""
        if self.states.state not in _WITHOUT_RUN:
            self._on(Command.ABORT, f"the host was suspended for {for_s:.1f} s")

    def step(self) -> None:
        """Bring the state machine and the table together.

        Everything that has led to a state is reported before that state is seen.
        """
        self._go_on(self._now_s())
        for report in self.orders.take_reports():
            self.figures.count(report)
            self._on_report(report)

    def _go_on(self, now_s: float) -> None:
        self._take_on_run()
        state, run = self.states.state, self._run
        if state in _WITHOUT_RUN:
            self._end_run(state)
        elif run is None or self._fault(run, now_s):
            self._on(*self._ended(run, now_s))
        elif state is State.STARTING and self.recipes.running != self.recipes.chosen:
            self._change_run()
        elif not self._slot.busy:
            self._on(*self._ended(run, now_s))
        else:
            run.keep(state is not State.EXECUTE and state not in _GOES_ON)
            self.orders.started |= state not in (State.RESETTING, State.IDLE)
            self._steer(run, state, now_s)

    def _take_on_run(self) -> None:
        """A run that has begun, by Reset or by hand, stands until the machine is started."""
        run = self._slot.coordinator
        if run is self._run or run is None or not self._slot.busy:
            return
        self._end_orders()
        self._run = run
        self._stops = None
        run.keep(True)
        program = run.program
        assert isinstance(program, TableProgram)
        self.orders.begin_run(self._passed_on)
        self.orders.started = False
        program.table.orders = self.orders
        program.table.recipe = self.recipes.running
        program.serve_orders()
        if self.states.state is State.STOPPED:
            try:
                self._on(Command.RESET, "started by hand")
            except CommandRefusedError as error:
                # The run ends: Stopped has none.
                self.states.reason = str(error)

    def _refusal(self) -> str:
        """Why no run may be started by hand now; empty if one may."""
        state, mode = self.states.state, self.states.mode
        if state is not State.STOPPED:
            name = state.name.capitalize()
            return f"the line is in {name}, and a person starts it in Stopped alone"
        if mode is Mode.MAINTENANCE:
            return "the line is in Maintenance; change its mode to Production first"
        return ""

    def _end_run(self, state: State) -> None:
        """Turn the motors off."""
        self._stops = None
        if self._slot.busy:
            self._slot.stop()
            self._ending = self._slot.coordinator
            return
        self._end_orders()
        ended, self._ending = self._ending, None
        fault = "" if ended is None or ended.fault is None else ended.fault
        if fault and state in (State.STOPPING, State.COMPLETED):
            self._on(Command.ABORT, fault)
        elif state in _ENDS:
            self.states.on(DONE, self._now_s(), fault)
            self._abort_commanded &= not fault

    def _end_orders(self) -> None:
        """End the orders of the run, if there was one, and forget its parcels."""
        program = None if self._run is None else self._run.program
        if isinstance(program, TableProgram):
            table = program.table
            self.orders.end_run(table.parcels, program.is_clear, len(table.unknown))

    def _change_run(self) -> None:
        """End the run of another recipe, which has moved nothing, and begin one of the chosen."""
        if self._stops is None and self._slot.busy:
            self._slot.stop()
            self._stops = self._slot.stops
        elif self._stops != self._slot.stops:
            self._on(Command.STOP, "stopped by hand")
        elif not self._slot.busy:
            if self._run is not None and isinstance(self._run.program, TableProgram):
                program, table = self._run.program, self._run.program.table
                self._passed_on = self.orders.begin_again(
                    table.parcels, program.is_clear, len(table.unknown)
                )
            # A refusal leads to Stopping, with its reason.
            with suppress(CommandRefusedError):
                self._reset()
            self._passed_on = None

    def _fault(self, run: Coordinator, now_s: float) -> str | None:
        if run.fault is not None or run.stuck is not None:
            return run.fault or run.stuck
        acting = (self.states.state, DONE) in TRANSITIONS
        if acting and now_s - self.states.since_s > _ACTING_LIMIT_S:
            why = f": {run.troubles[-1][1]}" if run.phase in TROUBLED else ""
            name = self.states.state.name.capitalize()
            return f"{name} takes more than {_ACTING_LIMIT_S:g} s{why}"
        return None

    def _ended(self, run: Coordinator | None, now_s: float) -> tuple[Command, str]:
        """The next command, with its reason: abort at a fault of the run, else stop."""
        fault = None if run is None else self._fault(run, now_s)
        if fault is not None:
            return Command.ABORT, fault
        return Command.STOP, "stopped by hand"

    def _steer(self, run: Coordinator, state: State, now_s: float) -> None:
        if state in (State.HOLDING, State.HELD) and run.phase in TROUBLED:
            self._trouble = run.troubles[-1][1]
        if state is State.RESETTING:
            if run.phase is Phase.KEEPING:
                self.states.on(DONE, now_s)
        elif state in _GOES_ON:
            if run.phase is Phase.RUNNING:
                self._stalled_s.clear()
                self.states.on(DONE, now_s)
        elif state in _RESTS:
            if run.phase in (Phase.KEEPING, *TROUBLED) and _stands(run):
                self.states.on(DONE, now_s)
        elif state is State.EXECUTE:
            self._watch(run, now_s)
        elif state is State.SUSPENDED and run.phase in TROUBLED:
            self._rest(Command.HOLD, run, run.troubles[-1][1])
        elif state is State.SUSPENDED and self._passing:
            self._pass_by(run, now_s)

    def _watch(self, run: Coordinator, now_s: float) -> None:
        """End Execute if something outside or inside demands it."""
        if run.phase in TROUBLED:
            self._rest(Command.HOLD, run, run.troubles[-1][1])
        elif not self._beats(self._in_control, now_s):
            limit = f"no heartbeat of {self._in_control} for {HEARTBEAT_LIMIT_S:g} s"
            self._rest(Command.SUSPEND, run, limit)
        elif run.finished and not self.orders.is_any_under_way:
            self._rest(Command.COMPLETE, run, "the job is done")
        elif stalled := self._stalled(run, now_s):
            self._rest(Command.SUSPEND, run, stalled + _in_the_way(run))
            self._passing = stalled

    def _rest(self, command: Command, run: Coordinator, reason: str) -> None:
        run.keep(True)
        self._on(command, reason)
        self._passing = ""
        self._trouble = reason if command is Command.HOLD else ""

    def _pass_by(self, run: Coordinator, now_s: float) -> None:
        """Leave Suspended by itself when chutes are free, or a parcel comes; never unwatched."""
        if not self._beats(self._in_control, now_s):
            self._passing = ""
            self.states.reason = f"no heartbeat of {self._in_control}"
        elif not self._stalls(run):
            self._passing = ""
            self._on(Command.UNSUSPEND, "parcels can go on")

    def _stalled(self, run: Coordinator, now_s: float) -> str:
        """Why no parcel has got on for long enough; empty if any has."""
        now = self._stalls(run)
        since_s = now_s if not now else self._stalled_s.get(now, now_s)
        self._stalled_s = {now: since_s}
        limit_s = STARVED_S if now == _STARVED else BLOCKED_S
        return now if now_s - since_s >= limit_s else ""

    def _stalls(self, run: Coordinator) -> str:
        """Why no parcel goes on now; empty if any does."""
        program = run.program
        assert isinstance(program, TableProgram)
        if not program.table.parcels:
            return _STARVED
        if self.orders.waiting and not program.traffic.under_way:
            return _BLOCKED.format(exits=", ".join(sorted(self.orders.full)))
        return ""

    def _beats(self, by: str, now_s: float) -> bool:
        return now_s - self._beats_s.get(by, -inf) <= HEARTBEAT_LIMIT_S

    def _on(self, command: Command, reason: str) -> None:
        """Take a command: the state changes, and the table follows at once where it has to."""
        self._abort_commanded = False
        self.states.on(command, self._now_s(), reason)
        if command is Command.RESET:
            self._reset()
        elif self._run is not None and self._slot.busy:
            self._run.keep(command not in MOVES or self.recipes.running != self.recipes.chosen)
            if command in (Command.STOP, Command.ABORT):
                self._slot.stop()

    def _reset(self) -> None:
        """Bring the cells up, all parcels kept standing."""
        if not self._slot.busy:
            try:
                self._slot.begin()
            except PageRefusedError as error:
                self.states.on(Command.STOP, self._now_s(), str(error))
                raise CommandRefusedError(str(error)) from None
            self._take_on_run()

    # To outside ----------------------------------------------------------------------------------

    def snapshot(self) -> dict[str, Any]:
        """Everything that a protocol shows, as plain values."""
        now_s, states, run = self._now_s(), self.states, self._run
        return {
            "state": int(states.state),
            "mode": int(states.mode),
            "reason": states.reason,
            "recipe": self.recipes.chosen,
            "since_s": now_s - states.since_s,
            "changes": states.changes,
            "spent_s": {int(each): states.in_state_s(each, now_s) for each in State},
            "alive": self._beats(self._in_control, now_s),
            "figures": asdict(self.figures),
            **effectiveness(states, self.figures, now_s, self.ideal_per_hour),
            "exits_full": [name in self.orders.full for name in self.exits],
            "orders_open": len(self.orders.open),
            "blocked": self._passing not in ("", _STARVED),
            "starved": self._passing == _STARVED,
            "alarm": self._alarm(),
            "parcels": self._parcels(run),
            "cells": [] if run is None else [int(cell.enabled) for cell in run.cells],
        }

    def shown(self) -> dict[str, Any]:
        """The view for a person: state, reason and alarm, counters by name, and orders as rows."""
        states, figures = self.states, self.figures
        effective = effectiveness(states, figures, self._now_s(), self.ideal_per_hour)
        counters: list[tuple[str, str]] = [
            ("recipe", self.recipes.chosen),
            ("parcels in", str(figures.parcels_in)),
            *((f"out by {name}", str(figures.out.get(name, 0))) for name in self.exits),
            ("rejected", str(figures.parcels_rejected)),
            ("lost", str(figures.parcels_lost)),
            ("parcels an hour in Execute", f"{effective['parcels_per_hour']:.0f}"),
            ("availability", f"{effective['availability']:.1%}"),
            ("quality", f"{effective['quality']:.1%}"),
            ("full exits", ", ".join(sorted(self.orders.full)) or "none"),
        ]
        return {
            "state": states.state.name.capitalize(),
            "mode": states.mode.name.capitalize(),
            "reason": states.reason,
            "alarm": self._alarm(),
            "counters": counters,
            "orders": self.orders.rows(_SHOWN_ORDERS),
        }

    def _alarm(self) -> dict[str, str] | None:
        """The alarm of a machine that was aborted, or waits for cells, with cause and cure."""
        run = self._run
        if self.states.state in (State.ABORTING, State.ABORTED):
            text, cure = self.states.reason, _CURE_ABORTED
            if self._abort_commanded:
                return {"text": text, "cause": _CAUSE_COMMANDED, "cure": _CURE_COMMANDED}
        elif self.states.state in (State.HOLDING, State.HELD) and self._trouble:
            text, cure = self._trouble, _CURE_HELD
        elif self.states.state is State.IDLE and run is not None and run.phase in TROUBLED:
            text, cure = run.troubles[-1][1], _CURE_IDLE
        else:
            return None
        if run is not None and "supply" in text:
            cut = KINDS["supply-low"]
            return {"text": text, "cause": cut.cause, "cure": cut.cure}
        return {"text": text, "cause": text, "cure": cure}

    def _parcels(self, run: Coordinator | None) -> list[dict[str, Any]]:
        if run is None or not self._slot.busy or not isinstance(run.program, TableProgram):
            return []
        return [
            {"parcel": self.orders.identity(each), "kind": each.kind, "pose": each.pose}
            for each in run.program.table.parcels
            if each.found
        ]


def _stands(run: Coordinator) -> bool:
    """Whether no wheel is to turn, and none that reports does."""
    speeds_m_s = np.nan_to_num(run.speeds_m_s)
    return not run.references_m_s.any() and bool((abs(speeds_m_s) < _STANDS_M_S).all())


def _in_the_way(run: Coordinator) -> str:
    """The unknown things on a table without parcels, for the end of a reason."""
    program = run.program
    assert isinstance(program, TableProgram)
    table = program.table
    if table.parcels or not table.unknown:
        return ""
    places = [f"{name} at {x_m:.2f}, {y_m:.2f} m" for name, (x_m, y_m) in table.unknown.items()]
    return f"; nobody knows {' and '.join(places[:3])}: take it off"
