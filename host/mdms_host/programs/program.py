"""A program that people write, as the coordinator runs it: cycle by cycle, in any kind of time."""

from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

from mdms_host.estimation.belief import Belief, Gain
from mdms_host.estimation.parcel import Parcel
from mdms_host.estimation.tracker import Tracker
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.program import Steered
from mdms_host.motion.trajectory.pushes import Mass, uniform_mass
from mdms_host.programs.newcomers import Comings, TrackedNewcomers, tracker_gate
from mdms_host.programs.order import Order
from mdms_host.programs.script import ScriptError, ScriptTask, failure_text, place_of
from mdms_host.programs.table import Table, TableDriver
from mdms_host.programs.table_parcel import ProgramError, TableParcel
from mdms_host.programs.traffic.by_cells import CellsTraffic
from mdms_host.programs.traffic.ordered import OrderedTraffic
from mdms_model.arrays import Floats
from mdms_protocol.neighbours.messages import Estimate, Lost, Page

#: A program that has been broken off is over once all parcels have been at rest for so long [s].
_RESTED_S = 0.2
#: The coroutine of a program, from beginning to end.
Main = Callable[[Table], Coroutine[Any, Any, None]]


@dataclass(frozen=True, slots=True)
class Member:
    """A parcel that may be on the table under this name; `lies` there at the beginning."""

    name: str
    kind: str
    length_m: float
    width_m: float
    shape: str = "rectangle"
    lies: bool = True


class TableProgram:
    """Runs `main` on a table; see `motion.program.Program`.

    It begins when all parcels that are to lie on the table have been found. A parcel of the members
    that comes to be believed on it has arrived.

    The orders of the table go to `traffic`, which knows the ways of all parcels. With `keeps_goals`
    it has no other aim than its goals.
    """

    def __init__(
        self,
        main: Main,
        table: Table,
        members: Sequence[Member],
        traffic: OrderedTraffic[Any],
        comings: Comings | None = None,
    ) -> None:
        self._main = main
        self.keeps_goals = False
        self._comings = comings
        self._tracker: Tracker | None = None
        self._members = {member.name: member for member in members}
        self._awaited = {member.name for member in members if member.lies}
        self.traffic = traffic
        self.table = table
        self.driver = TableDriver(table)
        table.expects = any(not member.lies for member in members)
        self._gone: set[str] = set()
        #: Parcels that have not come after all, and are on the table until they are taken out.
        self._withdrawn: set[str] = set()
        #: The exit that each parcel has set out to.
        self._exits: dict[str, str] = {}
        self._serves_orders = False
        #: The last order for each parcel that was given beside the program, and why some were
        #: given up whose goals are kept.
        self._given: dict[str, Order] = {}
        self._given_up: dict[str, str] = {}
        self._doubts = False
        self._task: ScriptTask[None] | None = None
        self._failure: str | None = None
        self._raised = False
        self._rested_s = 0.0
        self._notices: list[str] = []

    def keep_goals(self, goals: Mapping[str, GoalPose]) -> None:
        """Take each parcel to its goal once it has been found, and keep it there; no other aim.

        A person may give other goals, which take the places of these.
        """
        self.keeps_goals = True
        self._awaited.clear()
        for name, goal in goals.items():
            self._give(name, goal)

    def attend(self, tracker: Tracker, heaviest_kg: float = inf) -> None:
        """Announce parcels that may come or leave from now on; no heavier ones may come."""
        self._tracker = tracker
        self.traffic.attend(lambda: tracker.parcels)
        self.table.newcomers = TrackedNewcomers(tracker, self._know, heaviest_kg, self._misfit)

    def serve_orders(self) -> None:
        """Carry out the orders of `table.orders` beside the program, from its beginning on."""
        self._serves_orders = True

    @property
    def is_clear(self) -> bool | None:
        """Whether nothing lies on the table; None where sensors have not shown all of it."""
        return None if self._tracker is None else self._tracker.is_clear

    def _know(self, parcel: Parcel, mass: Mass, kind: str, comes: bool) -> None:
        """There is to be a parcel that has not been drawn before; it `comes`, or is there."""
        self.traffic.know(parcel, mass)
        self._members[parcel.name] = Member(
            parcel.name, kind, parcel.length_m, parcel.width_m, parcel.shape, lies=not comes
        )

    def _misfit(self, _parcel: Parcel) -> str | None:
        """Why the table cannot carry a parcel, None where it can."""
        return None

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """These cells (from 1) are lost, and no others."""
        self.traffic.on_lost_cells(cells)

    @property
    def began(self) -> bool:
        """Whether the program has begun: its parcels have been found."""
        return self._task is not None

    @property
    def finished(self) -> bool:
        """Whether the program has come to its end, and parcels to where a person wants them."""
        if self._task is None or not self._task.done or self._failure is not None:
            return False
        if self.keeps_goals:
            return not (self._doubts or self._left)
        return all(order.over for order in self._given.values())

    @property
    def stuck(self) -> str | None:
        """Why the program was broken off, once all parcels rest; None before.

        A program of goals is, once it has given up all parcels that are not at their goals.
        """
        reason, left = self._failure, self._left
        if self.keeps_goals and left and left <= self._given_up.keys():
            reason = "; ".join(self._given_up[name] for name in self._given if name in left)
        return reason if self._rested_s >= _RESTED_S else None

    @property
    def _left(self) -> set[str]:
        """Parcels that are not at their goals."""
        return {name for name, one in self.traffic.steered.items() if not one.arrived}

    @property
    def failed(self) -> bool:
        """Whether it was broken off by an error in it, and not for what cannot be done."""
        return self._raised

    @property
    def waits_at(self) -> tuple[str, ...]:
        """Where in the program each of its tasks waits, if any does."""
        return self.driver.waits_at

    @property
    def endless(self) -> bool:
        """Whether it waits for events from outside, and would do so for ever.

        Tasks that it has started and does not await do not count: it comes to its end without them.
        """
        return self._failure is None and self._task is not None and self._task.waits_for_outside

    @property
    def awaits(self) -> Collection[str]:
        """Parcels that must be found before the program begins, or before their goals count."""
        if self.keeps_goals:
            return self.traffic.steered.keys()
        return self._awaited if self._task is None else ()

    @property
    def near(self) -> Collection[str]:
        """Parcels about to arrive."""
        return self.traffic.near

    @property
    def controllers(self) -> Mapping[str, Steered]:
        """The follower of each parcel that has been ordered to a place."""
        return self.traffic.steered

    def set_goal(self, name: str, goal: GoalPose) -> None:
        """Order a parcel to a place; this replaces any order of the program.

        Raises KeyError for a parcel that neither is on the table nor has a goal.
        """
        if name not in self._given and name not in {one.name for one in self.table.parcels}:
            raise KeyError(name)
        self._give(name, goal)

    def _give(self, name: str, goal: GoalPose) -> None:
        self._given[name] = order = Order(name, goal, kept=self.keeps_goals)
        self._given_up.pop(name, None)
        self.traffic.give(order)

    def take_notices(self) -> list[str]:
        """Notices about parcels since the last call."""
        notices, self._notices = self._notices, []
        return notices + self.traffic.take_notices()

    def references_m_s(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References of shape (W,) for the next step, given the beliefs at its beginning."""
        self._withdraw()
        self._take_out(beliefs)
        self._take_in(beliefs)
        if self._task is None and self._awaited <= beliefs.keys():
            self._task = self.table.start(self._main(self.table))
            if self._serves_orders:
                self.table.serve_orders()
        if self._task is not None and self._failure is None:
            self._go_on(step_s)
        references_m_s = self.traffic.step(beliefs, step_s)
        self._doubts = any(belief.doubtful for belief in beliefs.values())
        self._note_refused()
        self._rested_s = self._rested_s + step_s if self.traffic.at_rest else 0.0
        if self._tracker is not None:
            for name, gate in self.traffic.take_leaving():
                if gate is None:
                    self._exits.pop(name, None)
                    self._tracker.stay(name)
                else:
                    self._exits[name] = gate.name
                    self._tracker.depart(name, tracker_gate(gate))
            if self._comings is not None:
                there = {*beliefs, *(parcel.name for parcel in self.table.parcels)}
                self._comings.step(self._tracker, there)
        return references_m_s

    @property
    def speeds_m_s(self) -> Floats:
        """How fast each wheel is to run under the references that were returned last, (W,)."""
        return self.traffic.speeds_m_s

    @property
    def gains(self) -> Mapping[str, Gain]:
        """Gains of the wheels under parcels in the step before these, and their pushes."""
        return self.traffic.gains

    def _withdraw(self) -> None:
        """Parcels that have not come after all are no more on the table, and expected again."""
        if self._tracker is None:
            return
        for parcel, region in self._tracker.take_withdrawn():
            if any(parcel.name == each.name for each in self.table.parcels):
                self._exits.pop(parcel.name, None)
                self._withdrawn.add(parcel.name)
                self.traffic.withdraw(parcel.name)
            if self._comings is None or not self._comings.brings(parcel.name):
                self._tracker.announce(parcel, region)

    def _note_refused(self) -> None:
        """Say of given goals that no parcel will come there.

        Beside a program of its own nothing is at fault then.
        """
        for name, order in list(self._given.items()):
            if order.refused is None or name in self._given_up:
                continue
            if order.kept:
                self._given_up[name] = order.refused
                self._notices.append(order.refused)
            else:
                del self._given[name]
                self.traffic.forget(name)
                self._notices.append(f"{name} is not taken to the given place: {order.refused}")

    def _take_out(self, beliefs: Mapping[str, Belief]) -> None:
        """Parcels that have left are no more on the table, though they may still be believed."""
        for name in self.traffic.take_left():
            self.driver.remove(name, self._exits.pop(name, None), withdrawn=name in self._withdrawn)
            self._withdrawn.discard(name)
            self._gone.add(name)
            if not self.keeps_goals:
                # The next parcel of this name is another.
                self._given.pop(name, None)
        self._gone &= beliefs.keys()

    def _take_in(self, beliefs: Mapping[str, Belief]) -> None:
        there = self._gone.union(parcel.name for parcel in self.table.parcels)
        for name, belief in beliefs.items():
            if belief.named and name not in self._members and self._tracker is not None:
                # A person has given a name to an unknown thing.
                parcel = self._tracker.parcels[name]
                self._know(parcel, uniform_mass(parcel.footprint), "", comes=False)
            member = self._members.get(name)
            if member is not None and name not in there:
                size = member.length_m, member.width_m, member.shape
                lay_there = self._tracker is not None and self._tracker.lay_there(name)
                come = TableParcel(name, member.kind, *size)
                self.driver.put(come, arrives=not member.lies, lay_there=lay_there)
        self.driver.see(beliefs)

    def _go_on(self, step_s: float) -> None:
        try:
            error = self.driver.step(step_s)
        except ScriptError as raised:
            error = raised
        self._notices += [
            f"the program blocks for {took_s * 1e3:.0f} ms, in {where}: meanwhile no setpoint goes "
            "out; write await table.sleep() in place of time.sleep(), and do long work in a thread"
            for where, took_s in self.driver.take_blocked()
        ]
        if error is None:
            self.traffic.forget_refused()
            return
        if isinstance(error, ProgramError):
            where = place_of(error)
            behind = f", in {where}" if where else ""
            self._failure = f"the program was broken off: {error}{behind}"
        else:
            self._raised = True
            self._failure = f"the program failed: {failure_text(error)}"
        self._notices.append(self._failure)
        self.driver.stop()


class CellsTableProgram(TableProgram):
    """The same as `TableProgram`, with goals for cells where that has references for wheels.

    See `motion.program.ByCells`.
    """

    traffic: CellsTraffic

    def _misfit(self, parcel: Parcel) -> str | None:
        return self.traffic.cells.misfit(parcel)

    def on_estimate(self, cell: int, estimate: Estimate, now_s: float) -> None:
        """A cell (from 1) has sent its estimate."""
        self.traffic.cells.on_estimate(cell, estimate, now_s)

    def on_answer(self, cell: int, answer: Lost) -> None:
        """A cell (from 1) has answered a page about a lost cell."""
        self.traffic.cells.on_answer(cell, answer)

    def on_silence(self, silent_s: Mapping[int, float]) -> None:
        """For how long nothing has come of each cell (from 1) [s]."""
        self.traffic.cells.on_silence(silent_s)

    def step(self, beliefs: Mapping[str, Belief], now_s: float, step_s: float) -> list[Page]:
        """The pages to send now, given the beliefs; once a cycle."""
        self.references_m_s(beliefs, step_s)
        pages = self.traffic.cells.step(beliefs, now_s, step_s)
        self.traffic.doubt_arrivals()
        return pages

    def begin_again(self) -> None:
        """Plan and send every parcel's way anew, from where the parcel is."""
        self.traffic.begin_again()

    def ends(self) -> list[Page]:
        """The pages that end all programs."""
        return self.traffic.cells.ends()
