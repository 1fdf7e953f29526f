"""Orders that a plant gives for parcels, beside the program of the table.

An order names a parcel by its identity, which a scanner may have announced. It takes the place of
the program's own order for that parcel. Everything runs in the cycle of the program.
"""

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import hypot, isfinite, pi, radians, remainder
from typing import TYPE_CHECKING, Any

from mdms_host.motion.goal import GoalPose
from mdms_host.programs.order import Gate, Order
from mdms_host.programs.script import ScriptTask, until
from mdms_host.programs.table_parcel import Leave, Move, ProgramError, TableParcel

if TYPE_CHECKING:
    from mdms_host.programs.table import Table

#: Announced parcels that have not come yet: bounded, since they come from outside.
MOST_EXPECTED = 1000
#: Reports that nobody has taken yet.
_MOST_REPORTS = 10_000
#: The text of a parcel that is lost between two runs.
_NOT_FOUND = "a parcel of a run before was not found again"
#: A parcel waits for a full exit so far before it [m], beside half of its own length.
_BEFORE_EXIT_M = 0.03


class OrderState(StrEnum):
    """How far an order has come."""

    ACCEPTED = "accepted"
    UNDER_WAY = "under way"
    ARRIVED = "arrived"
    LEFT = "left"
    REFUSED = "refused"
    CANCELLED = "cancelled"
    #: It was under way when the run or the host ended: nobody knows how far it came.
    IN_DOUBT = "in doubt"


#: Nothing more comes of an order in these states.
CLOSED = (OrderState.ARRIVED, OrderState.LEFT, OrderState.REFUSED, OrderState.CANCELLED)


@dataclass(frozen=True, slots=True)
class LineOrder:
    """An order for the parcel of an identity: an exit to leave by, or a pose [m, m, rad].

    `key` names the order itself. Of several orders for a parcel the one of the highest `priority`
    is carried out first, and the earliest of those.
    """

    key: str
    parcel: str
    exit: str | None = None
    x_m: float | None = None
    y_m: float | None = None
    yaw_rad: float | None = None
    priority: int = 0

    @property
    def error(self) -> str | None:
        """Why nobody can carry it out; None if it makes sense."""
        if not self.key or not self.parcel:
            return "an order needs a key and a parcel"
        if (self.exit is None) == (self.x_m is None or self.y_m is None):
            return f"order {self.key}: give either exit, or x_m and y_m"
        pose = {"x_m": self.x_m, "y_m": self.y_m, "yaw_rad": self.yaw_rad}
        for name, value in pose.items():
            if value is not None and not isfinite(value):
                return f"order {self.key}: {name} is {value}, but must be a number"
        return None


@dataclass(frozen=True, slots=True)
class Report:
    """An event of a parcel: found, under way, arrived, left, refused or lost.

    It is withdrawn if it was found by mistake: its identity is expected again. It is unannounced if
    its identity is not expected any more: announce it again, if it has not come. A parcel that was
    lost, or has left otherwise than the plant wants, is `rejected`. A parcel that lay there from a
    run before came in that run: it is not `new`.
    """

    event: str
    parcel: str
    key: str = ""
    exit: str = ""
    text: str = ""
    rejected: bool = False
    new: bool = True


class TableOrders:
    """The orders of a plant at a table; empty at a table without one.

    `open` are the orders that wait or are under way, `full` the exits that take no parcels.
    """

    def __init__(self) -> None:
        self.open: dict[str, LineOrder] = {}
        self.full: set[str] = set()
        self.identities: dict[str, str] = {}
        #: The identities of parcels on the table that no scanner has announced, by name.
        self._unscanned: dict[str, str] = {}
        #: Names of parcels that lay there from a run before.
        self._old: set[str] = set()
        #: Whether the run may move parcels; until then those with orders lie where they are.
        self.started = True
        #: Parcels that have come, and neither left nor been lost.
        self.remaining = 0
        #: Whether nothing lay on the table when it was seen last.
        self.was_clear = True
        self._expected: deque[tuple[str, str]] = deque()
        #: Kinds of announced parcels that are on the table, as announced, by name.
        self._announced: dict[str, str] = {}
        #: Identities that go over to the next run, by kind; None without such a run.
        self._passed_on: dict[str, str] | None = None
        #: Whether a scanner has announced any parcel.
        self._has_scanner = False
        #: Names of parcels whose last order was refused.
        self._refused: set[str] = set()
        self._runs = False
        self._under_way: dict[str, tuple[LineOrder, TableParcel]] = {}
        self._reports: deque[Report] = deque(maxlen=_MOST_REPORTS)
        #: Orders of parcels that wait before a full exit, to the places where they do.
        self._waiting: set[Order] = set()
        #: The task that carries out the order of each parcel, by its name.
        self._tasks: dict[str, ScriptTask[None]] = {}
        self._serves = False
        #: Parcels that the plant has brought to where they are.
        self._arrived: dict[str, TableParcel] = {}
        #: Orders that were under way when a run ended, until sensors show that they are done.
        self.in_doubt: dict[str, LineOrder] = {}

    # From outside --------------------------------------------------------------------------------

    def give(self, order: LineOrder) -> None:
        """Carry an order out as soon as its parcel is there."""
        self.open[order.key] = order

    def cancel(self, key: str) -> bool:
        """Drop an order that has not begun to move its parcel, or that waits before its full exit.

        Returns whether it was dropped. Such a parcel stands there, until it is ordered elsewhere.
        """
        order = self.open.get(key)
        if order is None:
            return False
        for name, (each, _) in list(self._under_way.items()):
            if each.key == key:
                # Of an exit that has just become free, the parcel is about to leave.
                waits = name in self.waiting and order.exit in self.full
                if self.started and not waits:
                    return False
                del self._under_way[name]
                self._tasks.pop(name).cancel()
        del self.open[key]
        return True

    def expect(self, identity: str, kind: str = "") -> None:
        """The next parcel of a kind that comes has this identity; of any kind without one.

        Raises ProgramError where very many are expected, and for an identity that is expected or
        on the table: a scanner that reports a parcel twice does not name the next one.
        """
        if len(self._expected) >= MOST_EXPECTED:
            raise ProgramError(f"{identity}: {MOST_EXPECTED} parcels are expected already")
        if any(identity == each for each, _ in self._expected):
            raise ProgramError(f"{identity} is expected already")
        if identity in (*self.identities.values(), *self._unscanned.values()):
            raise ProgramError(f"{identity} is on the table already")
        self._expected.append((identity, kind))
        self._has_scanner = True

    def expect_no_more(self, identity: str) -> None:
        """An announced parcel does not come after all. Raises ProgramError for another one."""
        expected = next((each for each in self._expected if each[0] == identity), None)
        if expected is None:
            raise ProgramError(f"{identity} is not expected")
        self._expected.remove(expected)

    def take_reports(self) -> list[Report]:
        """Reports since the last call."""
        reports = list(self._reports)
        self._reports.clear()
        return reports

    def begin_run(self, passed_on: dict[str, str] | None = None) -> None:
        """A run has begun; parcels that it finds are told by `on_parcel`.

        Where something was left on the table, an announced parcel may lie there by now, or may be
        still to come. So none is expected any more. `passed_on` is what `begin_again` has returned.
        """
        self._runs = True
        self._passed_on = passed_on
        if not self.was_clear and passed_on is None:
            self._forget_expected()

    def _forget_expected(self) -> None:
        for identity, _ in self._expected:
            self._reports.append(Report("unannounced", identity))
        self._expected.clear()

    def end_run(
        self, parcels: Sequence[TableParcel] = (), is_clear: bool | None = None, unknown: int = 0
    ) -> None:
        """The run has ended: its parcels are unknown, and orders under way are in doubt.

        Of its `parcels` those are lost that sensors do not show any more. `is_clear` is whether
        nothing lay on the table in the end; None where nobody knows. So many things that lay there
        are `unknown`. Any of them may be a parcel of a run before; others of those are lost.
        """
        if not self._runs:
            return
        self._runs = False
        for parcel in parcels:
            if not parcel.found:
                self.remaining -= 1
                self._report("lost", parcel, rejected=True)
        if is_clear is not None:
            self.was_clear = is_clear
            there = 0 if is_clear else unknown + sum(parcel.found for parcel in parcels)
            # A run that ends before it has started has not looked for all of them.
            while self.remaining > there and (is_clear or self.started):
                self.remaining -= 1
                self._reports.append(Report("lost", "", text=_NOT_FOUND, rejected=True))
        for order, _ in self._under_way.values():
            self.open.pop(order.key, None)
            self.in_doubt[order.key] = order
            self._reports.append(Report("in doubt", order.parcel, order.key))
        self._under_way.clear()
        self.identities.clear()
        self._unscanned.clear()
        self._old.clear()
        self._announced.clear()
        self._passed_on = None
        # Tasks of the run that are dropped later clean up their own set.
        self._waiting = set()
        self._tasks.clear()
        self._arrived.clear()
        self._refused.clear()
        self._serves = False

    def begin_again(
        self, parcels: Sequence[TableParcel], is_clear: bool | None = None, unknown: int = 0
    ) -> dict[str, str]:
        """The run has ended without having moved any of its parcels, and another one follows.

        Returns the identities that go over to that, by kind. Its orders are to be carried out by
        that. A parcel that is the only one of its kind keeps its identity; others could be mixed
        up.
        """
        for order, _ in self._under_way.values():
            self._reports.append(Report("accepted", order.parcel, order.key))
        self._under_way.clear()
        kinds = Counter(parcel.kind for parcel in parcels)
        passed_on = {
            parcel.kind: self.identities[parcel.name]
            for parcel in parcels
            if parcel.name in self.identities and kinds[parcel.kind] == 1
        }
        self.end_run(parcels, False if parcels else is_clear, unknown)
        return passed_on

    # What a program may ask ----------------------------------------------------------------------

    @property
    def waiting(self) -> frozenset[str]:
        """Names of parcels that wait for a full exit."""
        return frozenset(order.parcel for order in self._waiting)

    @property
    def is_any_under_way(self) -> bool:
        """Whether any parcel follows an order now."""
        return bool(self._under_way)

    def identity(self, parcel: TableParcel) -> str:
        """The identity of a parcel on the table: its name, where no scanner has said another.

        Where another parcel has that name for its identity, ` (not scanned)` stands behind it.
        """
        name = parcel.name
        return self.identities.get(name) or self._unscanned.get(name, name)

    def order_for(self, parcel: TableParcel) -> LineOrder | None:
        """The order that a parcel is to follow next, if any."""
        identity = self.identity(parcel)
        mine = [order for order in self.open.values() if order.parcel == identity]
        return max(mine, key=lambda order: order.priority, default=None)

    def rows(self, most: int) -> list[tuple[str, str, str, str]]:
        """Orders for a person, those under way first: key, parcel, place and state."""
        under_way = {order.key for order, _ in self._under_way.values()}
        known = [
            *(
                (order, OrderState.UNDER_WAY)
                for order in self.open.values()
                if order.key in under_way
            ),
            *((order, OrderState.IN_DOUBT) for order in self.in_doubt.values()),
            *(
                (order, OrderState.ACCEPTED)
                for order in self.open.values()
                if order.key not in under_way
            ),
        ]
        return [
            (order.key, order.parcel, order.exit or f"{order.x_m:g}, {order.y_m:g} m", str(state))
            for order, state in known[:most]
        ]

    # The table's side ----------------------------------------------------------------------------

    def on_parcel(self, parcel: TableParcel, *, lay_there: bool = False) -> None:
        """A parcel has been found on the table; it `lay_there` if it did so before this run.

        Such a parcel takes no announced identity if anything was left on the table: it may be that.
        """
        if not lay_there or self.was_clear:
            self._take_expected(parcel)
        elif self._passed_on is not None:
            self._take_passed_on(parcel, self._passed_on)
        if parcel.name not in self.identities:
            expected = (identity for identity, _ in self._expected)
            is_taken = parcel.name in (*self.identities.values(), *expected)
            suffix = " (not scanned)" if is_taken else ""
            self._unscanned[parcel.name] = parcel.name + suffix
        # All parcels of this run have an identity, so others that remain came in a run before.
        known = self.identities.keys() | self._unscanned.keys()
        is_old = lay_there and self.remaining >= len(known)
        (self._old.add if is_old else self._old.discard)(parcel.name)
        self.remaining += not is_old
        self._report("found", parcel, new=not is_old)

    def _take_passed_on(self, parcel: TableParcel, identities: dict[str, str]) -> None:
        if parcel.kind in identities:
            self.identities[parcel.name] = identities.pop(parcel.kind)
        else:
            # It may have come between the two runs.
            self._forget_expected()

    def _take_expected(self, parcel: TableParcel) -> None:
        fitting = (each for each in self._expected if each[1] in ("", parcel.kind))
        expected = next(fitting, None)
        if expected is not None:
            self._expected.remove(expected)
            self.identities[parcel.name], self._announced[parcel.name] = expected

    def on_withdrawn(self, parcel: TableParcel) -> None:
        """A parcel was found by mistake: its identity is that of the next one, with its order."""
        under_way = self._under_way.pop(parcel.name, None)
        if under_way is not None:
            self._report("accepted", parcel, key=under_way[0].key)
        kind = self._announced.pop(parcel.name, None)
        is_new = parcel.name not in self._old
        self.remaining -= is_new
        self._report("withdrawn", parcel, new=is_new)
        self._unscanned.pop(parcel.name, None)
        identity = self.identities.pop(parcel.name, None)
        if identity is not None and kind is not None:
            self._expected.appendleft((identity, kind))
        self._wait_no_more(parcel)
        self._refused.discard(parcel.name)

    def on_left(self, parcel: TableParcel, exit: str | None) -> None:
        """A parcel is no more on the table; without an exit it was lost or taken away."""
        order, _ = self._under_way.pop(parcel.name, (None, None))
        if order is not None:
            # It is over by this, also where its task was broken off with the program.
            self.open.pop(order.key, None)
        self.remaining -= 1
        if exit is None:
            self._report("lost", parcel, key=order.key if order else "", rejected=True)
        elif order is not None and order.exit == exit:
            self._report("left", parcel, key=order.key, exit=exit)
        else:
            if order is not None:
                self._report("refused", parcel, key=order.key, text=f"it has left by {exit}")
            unknown = self._has_scanner and parcel.name not in self.identities
            rejected = order is not None or parcel.name in self._refused or unknown
            self._report("left", parcel, exit=exit, rejected=rejected)
        self._refused.discard(parcel.name)
        self.identities.pop(parcel.name, None)
        self._unscanned.pop(parcel.name, None)
        self._announced.pop(parcel.name, None)
        self._wait_no_more(parcel)
        self._arrived.pop(parcel.name, None)

    async def serve(self, table: "Table", move: Move, leave: Leave) -> None:
        """Carry out orders for the parcels on the table, for ever."""
        self._serves = True
        while True:
            for parcel in table.parcels:
                self._confirm(parcel)
                order = self.order_for(parcel)
                if order is not None and parcel.found and parcel.name not in self._under_way:
                    self._under_way[parcel.name] = order, parcel
                    task = table.start(self._carry_out(parcel, order, move, leave))
                    self._tasks[parcel.name] = task
            await table.sleep(0.0)

    def _confirm(self, parcel: TableParcel) -> None:
        """Report an order in doubt as done if sensors show its parcel at the place."""
        identity = self.identity(parcel)
        for key, order in list(self.in_doubt.items()):
            mine = order.parcel == identity and order.exit is None and parcel.found
            if mine and _is_there(parcel, order):
                del self.in_doubt[key]
                self._report("arrived", parcel, key=key)

    async def carried_out(self, parcel: TableParcel) -> bool:
        """Wait for the plant's orders for a parcel, if any; whether the last was carried out."""
        if not self._serves:
            return False
        await until(lambda: parcel.has_left or not self._is_ordered(parcel))
        return parcel.has_left or self._arrived.get(parcel.name) is parcel

    def _is_ordered(self, parcel: TableParcel) -> bool:
        return parcel.name in self._under_way or self.order_for(parcel) is not None

    async def _carry_out(
        self, parcel: TableParcel, order: LineOrder, move: Move, leave: Leave
    ) -> None:
        self._report("under way", parcel, key=order.key)
        await until(lambda: self.started)
        identity = self.identity(parcel)
        is_there, text = False, "the program or a person has ordered the parcel elsewhere"
        try:
            if order.exit is not None:
                await leave(parcel, order.exit)
            else:
                assert order.x_m is not None
                assert order.y_m is not None
                await move(parcel, order.x_m, order.y_m, order.yaw_rad)
                is_there = parcel.found and _is_there(parcel, order)
        except ProgramError as error:
            text = str(error)
        if self._under_way.get(parcel.name) != (order, parcel):
            # It has left, which has been reported, or was withdrawn: the order waits for another.
            return
        if is_there:
            self._arrived[parcel.name] = parcel
            self._reports.append(Report("arrived", identity, order.key))
        else:
            self._reports.append(Report("refused", identity, order.key, text=text))
            self._refused.add(parcel.name)
        # Not in `finally`: an order of a program that is broken off stays under way, until the run
        # ends and puts it in doubt.
        self.open.pop(order.key, None)
        self._under_way.pop(parcel.name, None)

    async def leave(
        self, parcel: TableParcel, gate: Gate, give: Callable[[GoalPose | Gate], Order]
    ) -> Order:
        """Have a parcel leave by a gate while that takes parcels; it waits before a full one.

        Returns the last order, which is over.
        """
        while True:
            if gate.name in self.full:
                before = await self._wait_before(parcel, gate, give)
                if before.replaced or parcel.has_left:
                    return before
            order = give(gate)
            await _until_over(order, lambda: self._must_wait(parcel, gate))
            if order.over:
                return order

    async def _wait_before(
        self, parcel: TableParcel, gate: Gate, give: Callable[[GoalPose | Gate], Order]
    ) -> Order:
        """Have a parcel wait before a full exit until it is free, or it is ordered elsewhere.

        A parcel that has no way there waits where it is.
        """
        order, waiting = give(_before(parcel, gate)), self._waiting
        waiting.add(order)
        try:
            await until(lambda: gate.name not in self.full or order.replaced or parcel.has_left)
        finally:
            waiting.discard(order)
        return order

    def _wait_no_more(self, parcel: TableParcel) -> None:
        self._waiting.difference_update([o for o in self._waiting if o.parcel == parcel.name])

    def _must_wait(self, parcel: TableParcel, gate: Gate) -> bool:
        """Whether a parcel that is not yet at its exit has to stop before it."""
        if gate.name not in self.full or not parcel.found:
            return False
        return gate.out_m(*parcel.pose[:2]) < -_depth_m(parcel) / 2

    def _report(self, event: str, parcel: TableParcel, **more: Any) -> None:
        self._reports.append(Report(event, self.identity(parcel), **more))


def _depth_m(parcel: TableParcel) -> float:
    """How far before an exit the middle of a parcel is that stands wholly on the table [m]."""
    return hypot(parcel.length_m, 0.0 if parcel.is_round else parcel.width_m) / 2 + _BEFORE_EXIT_M


async def _until_over(order: Order, interrupted: Callable[[], bool]) -> None:
    await until(lambda: order.over or interrupted())


def _before(parcel: TableParcel, gate: Gate) -> GoalPose:
    return GoalPose(*gate.place_m(-_depth_m(parcel)), None)


def _is_there(parcel: TableParcel, order: LineOrder) -> bool:
    """Whether a parcel lies at the pose of its order, within a centimetre and 2 degrees.

    Half a turn is left out: a box looks the same after it.
    """
    x_m, y_m, yaw_rad = parcel.pose
    near = hypot(x_m - (order.x_m or 0.0), y_m - (order.y_m or 0.0)) < 0.01
    if order.yaw_rad is None or parcel.is_round:
        return near
    return near and abs(remainder(yaw_rad - order.yaw_rad, pi)) < radians(2.0)


def order_of(values: Mapping[str, Any]) -> LineOrder:
    """An order of plain values, as protocols have them. Raises ProgramError."""
    try:
        x_m, y_m, yaw_rad = (_number(values.get(key)) for key in ("x_m", "y_m", "yaw_rad"))
        key, parcel = str(values["key"]), str(values["parcel"])
        exit, priority = values.get("exit") or None, int(values.get("priority", 0))
        order = LineOrder(key, parcel, exit, x_m, y_m, yaw_rad, priority)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ProgramError(f"an order that is none: {error}") from None
    if order.error is not None:
        raise ProgramError(order.error)
    return order


def _number(value: Any) -> float | None:
    return None if value is None else float(value)
