"""The table as a program sees it: parcels that come, are moved, and leave."""

from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from difflib import get_close_matches
from math import inf
from typing import Any, Protocol, TypeVar

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Footprint
from mdms_host.motion.goal import GoalPose
from mdms_host.programs.order import Gate, Order
from mdms_host.programs.script import Condition, Done, Outside, Script, ScriptTask, until
from mdms_host.programs.table_orders import TableOrders
from mdms_host.programs.table_parcel import (
    Newcomer,
    Newcomers,
    ProgramError,
    TableParcel,
    number_of,
)
from mdms_model.arrays import Floats
from mdms_model.scenario.limit import PLACE

__all__ = ["Newcomer", "ProgramError", "Table", "TableParcel"]

Result = TypeVar("Result")
#: A thing that was named is found within this, or is another thing [s].
_FOUND_S = 3.0
#: Values under a name that wait to be taken: bounded, since anybody outside sends them.
_MOST_SIGNALS = 1000


class Traffic(Protocol):
    """Carries out orders for parcels."""

    def give(self, order: Order) -> None:
        """Take an order in place of any other for its parcel."""
        ...

    def cancel(self, order: Order) -> None:
        """Bring the parcel of an order to rest, if the order is in force."""
        ...

    def stop(self) -> None:
        """Bring all parcels to rest, and hold them there."""
        ...


class Table:
    """A program's table: parcels by name, gates by name, and events to wait for.

    `table["box"]` is the parcel of that name. Times are those of the array's own cycle, `now_s`
    from the program's beginning. The table reaches `half_m` from its middle, along x and along y.
    `gates` are its exits by name.

    >>> class Swift:
    ...     def give(self, order):
    ...         print(f"{order.parcel} to {order.goal.x_m} m, {order.goal.y_m} m")
    ...         order.done = True
    >>> async def main(table):
    ...     box = table["box"]
    ...     await box.move(0.1, 0.0)
    ...     await table.sleep(0.02)
    ...     await box.move(-0.1, 0.0)
    >>> table = Table((0.57, 0.38), (), Swift())
    >>> driver = TableDriver(table)
    >>> driver.put(TableParcel("box", "", 0.36, 0.30, "rectangle"), arrives=False)
    >>> task = table.start(main(table))
    >>> driver.step(0.01)
    box to 0.1 m, 0.0 m
    >>> driver.step(0.01)
    >>> driver.step(0.01)
    box to -0.1 m, 0.0 m
    >>> task.done
    True
    """

    def __init__(
        self, half_m: tuple[float, float], gates: Sequence[Gate], traffic: Traffic
    ) -> None:
        self.now_s = 0.0
        self.half_m = half_m
        #: Whether any parcel may come.
        self.expects = True
        self.gates: Mapping[str, Gate] = {gate.name: gate for gate in gates}
        self.newcomers: Newcomers | None = None
        #: Kinds of parcels, each with an exit that was asked for by its name.
        self.asked_exits: set[tuple[str, str]] = set()
        #: The recipe that the plant around the table has chosen; empty without a plant.
        self.recipe = ""
        #: The orders of the plant around the table, and the exits that are full.
        self.orders = TableOrders()
        self._traffic = traffic
        self._script = Script()
        self._unknown: dict[str, tuple[Floats, Footprint]] = {}
        self._parcels: dict[str, TableParcel] = {}
        self._arrived: list[TableParcel] = []
        self._signals: dict[str, deque[Any]] = {}
        self._takes_signals = True

    # Parcels and places --------------------------------------------------------------------------

    @property
    def parcels(self) -> tuple[TableParcel, ...]:
        """All parcels on the table, in the order of their coming."""
        return tuple(self._parcels.values())

    def __getitem__(self, name: str) -> TableParcel:
        """The parcel of that name on the table. Raises ProgramError without one."""
        parcel = self._parcels.get(name) if isinstance(name, str) else None
        if parcel is None:
            there = ", ".join(self._parcels) or "none"
            close = get_close_matches(str(name), self._parcels, n=1)
            hint = f"did you mean {close[0]!r}? there are: " if close else "there are: "
            raise ProgramError(f"no parcel {name!r} is on the table; {hint}{there}")
        return parcel

    @property
    def unknown(self) -> Mapping[str, tuple[float, float]]:
        """Middle of all that nobody has named [m; table frame], by what messages call it."""
        return {name: _place(pose) for name, (pose, _) in self._unknown.items()}

    def unknown_at(self, x_m: float, y_m: float) -> str | None:
        """The unknown thing that may lie over a place; None without any."""
        point = np.array([[x_m, y_m]])
        away_m = (
            (float(outline.distance_m(point, pose)[0]), name)
            for name, (pose, outline) in self._unknown.items()
        )
        nearest_m, name = min(away_m, default=(inf, None))
        return name if nearest_m < 0.0 else None

    def exit_for(self, parcel: TableParcel) -> str:
        """The exit that a parcel's kind is to leave by. Raises ProgramError without one."""
        for gate in self.gates.values():
            if parcel.kind in gate.kinds:
                return gate.name
        raise ProgramError(f"no exit is for parcels of the kind {parcel.kind!r}, as {parcel.name}")

    # Requests of a program -----------------------------------------------------------------------

    async def arrival(self) -> TableParcel:
        """The next parcel that comes onto the table; each is returned once.

        Raises ProgramError where none may come.
        """
        if not (self.expects or self._arrived):
            raise ProgramError("no parcel is to come: there is no stream, and none was announced")
        await self._outside(lambda: bool(self._arrived))
        return self._arrived.pop(0)

    async def arrivals(self, count: int | None = None) -> AsyncIterator[TableParcel]:
        """Parcels as they come, so many of them, or without end."""
        came = 0
        while count is None or came < count:
            yield await self.arrival()
            came += 1

    def announce(self, newcomer: Newcomer, near_m: tuple[float, float] | None = None) -> None:
        """Expect a parcel of a known size, near a place or anywhere; `arrival` returns it.

        Raises ProgramError for a name that is taken, or without a size.
        """
        if newcomer.length_m is None:
            raise ProgramError(f"{newcomer.name} needs a size to be announced")
        if near_m is not None:
            near_m = _place_of(newcomer.name, *near_m)
        self._taken_in().announce(newcomer, near_m)
        self.expects = True

    async def name(self, newcomer: Newcomer, x_m: float, y_m: float) -> TableParcel:
        """Give a name to the unknown thing at a place; returns it as a parcel, once found.

        Raises ProgramError if no unknown thing lies there, or none of that size.
        """
        x_m, y_m = _place_of(newcomer.name, x_m, y_m)
        unknown = self.unknown_at(x_m, y_m)
        if unknown is None:
            raise ProgramError(f"nothing unknown lies at ({x_m:g} m, {y_m:g} m)")
        newcomers, limit_s = self._taken_in(), self.now_s + _FOUND_S
        newcomers.name(unknown, newcomer)
        await until(lambda: newcomer.name in self._parcels or self.now_s > limit_s)
        if newcomer.name not in self._parcels:
            newcomers.give_up(newcomer.name)
            raise ProgramError(f"{unknown} has not the outline of {newcomer.name}")
        return self[newcomer.name]

    def _taken_in(self) -> Newcomers:
        if self.newcomers is None:
            raise ProgramError("no parcels can be announced or named on this table")
        return self.newcomers

    async def sleep(self, seconds: float) -> None:
        """Let so much time of the array pass, a cycle at least. Raises ProgramError for no time."""
        if seconds != inf:
            what = "the time to sleep [s]"
            seconds = number_of(seconds, what, "at least 0", lambda number: number >= 0.0)
        begun_s = self.now_s
        # Cycles add up to a time by rounding only.
        await until(lambda: self.now_s > begun_s and self.now_s >= begun_s + seconds - 1e-9)

    def start(self, routine: Coroutine[Any, Any, Result]) -> ScriptTask[Result]:
        """Have a coroutine go on beside all else; its result may be awaited.

        An error in it ends the program if no coroutine awaits it.
        """
        return self._script.start(routine)

    async def together(self, *routines: Coroutine[Any, Any, Any]) -> None:
        """Have all of these go on beside each other; returns when the last is done.

        Then it raises the ProgramError of the first of them that failed. Raises any other error at
        once. They are broken off with the task that waits here.
        """
        tasks = [self.start(routine) for routine in routines]
        for task in tasks:
            task.heed()

        def fault() -> BaseException | None:
            errors = (task.error for task in tasks if task.error is not None)
            return next((each for each in errors if not isinstance(each, ProgramError)), None)

        try:
            for task in tasks:
                await until(Done(task, lambda: fault() is not None))
        except GeneratorExit:
            for task in tasks:
                task.cancel()
            raise
        if error := fault():
            raise error
        for task in tasks:
            task.result()

    async def signal(self, name: str) -> Any:
        """The next value that has been sent under a name, in the order of sending.

        Values wait until they are taken.
        """
        queue = self._waiting_under(name)
        await self._outside(lambda: bool(queue))
        return queue.popleft()

    def send_signal(self, name: str, value: Any = None) -> None:
        """Send a value to the program; any thread may do so.

        Raises ProgramError in virtual time, where only `[[signal]]` of the scenario and `signals=`
        send any: a run must not depend on the machine's time. So too where very many values wait
        under that name: nobody takes them.
        """
        if not self._takes_signals:
            raise ProgramError(
                f"signal {name!r}: in virtual time signals come from the scenario ([[signal]]) or "
                "from signals=, each with its time"
            )
        queue = self._waiting_under(name)
        if len(queue) >= _MOST_SIGNALS:
            raise ProgramError(
                f"signal {name!r}: {len(queue)} values wait already, and the program takes none"
            )
        queue.append(value)

    def _waiting_under(self, name: str) -> deque[Any]:
        """The values under a name that wait to be taken; of very many the oldest are dropped."""
        return self._signals.setdefault(name, deque(maxlen=_MOST_SIGNALS))

    async def _outside(self, condition: Condition) -> None:
        """Wait for an event from outside: a program that does has no end of its own."""
        await until(Outside(condition))

    def serve_orders(self) -> None:
        """Carry out the orders of the plant from now on, in the place of the program's own."""
        self.start(self.orders.serve(self, self._move, self._leave))

    async def _move_by_program(
        self, parcel: TableParcel, x_m: float, y_m: float, yaw_rad: float | None
    ) -> None:
        if not await self._is_of_plant(parcel):
            await self._move(parcel, x_m, y_m, yaw_rad)

    async def _leave_by_program(self, parcel: TableParcel, exit: str | None) -> None:
        if not await self._is_of_plant(parcel):
            await self._leave(parcel, exit)

    async def _is_of_plant(self, parcel: TableParcel) -> bool:
        """Wait for the plant's orders for a parcel; whether they took the place of this one."""
        is_of_plant = await self.orders.carried_out(parcel)
        if is_of_plant:
            # A program that orders it to and fro would go round without end in one cycle.
            await self.sleep(0.0)
        return is_of_plant

    async def _move(
        self, parcel: TableParcel, x_m: float, y_m: float, yaw_rad: float | None
    ) -> None:
        x_m, y_m = _place_of(parcel.name, x_m, y_m)
        if yaw_rad is not None:
            yaw_rad = number_of(yaw_rad, f"yaw_rad of {parcel.name}")
        if parcel.is_round and yaw_rad:
            raise ProgramError(f"{parcel.name} is round: no sensor shows how it is turned")
        await self._order(parcel, GoalPose(x_m, y_m, None if parcel.is_round else yaw_rad))

    async def _leave(self, parcel: TableParcel, exit: str | None) -> None:
        name = self.exit_for(parcel) if exit is None else exit
        gate = gate_of(self.gates, name)
        if exit is not None:
            self.asked_exits.add((parcel.kind, exit))
        given: list[Order] = []

        def give(goal: GoalPose | Gate) -> Order:
            given.append(self._give(parcel, goal))
            return given[-1]

        try:
            order = await self.orders.leave(parcel, gate, give)
        finally:
            self._cancel(given)
        # A parcel that is not there any more was perhaps refused a place to wait at before.
        if not parcel.has_left:
            _check_done(order)

    async def _order(self, parcel: TableParcel, goal: GoalPose | Gate) -> None:
        order = self._give(parcel, goal)
        try:
            await until(lambda: order.over)
        finally:
            self._cancel([order])
        _check_done(order)

    def _cancel(self, orders: Sequence[Order]) -> None:
        """A task that is broken off orders nothing any more."""
        for order in orders:
            if not order.over:
                self._traffic.cancel(order)

    def _give(self, parcel: TableParcel, goal: GoalPose | Gate) -> Order:
        if self._parcels.get(parcel.name) is not parcel:
            raise ProgramError(f"{parcel.name} has left the table")
        order = Order(parcel.name, goal)
        self._traffic.give(order)
        return order


#: Parcels that came or left are kept for the record of a run, if there is one.
_MOST_UNTAKEN = 1000


class TableDriver:
    """Drives a table cycle by cycle: the cycle's beliefs go in, and the program goes on."""

    def __init__(self, table: Table) -> None:
        self.table = table
        #: How many parcels have come, and how many have left, by the names of exits.
        self.came = 0
        self.left: Counter[str] = Counter()
        self._flow: deque[tuple[str, str | None]] = deque(maxlen=_MOST_UNTAKEN)
        self._on_blocked: Callable[[str, float], object] = lambda _where, _took_s: None

    @property
    def waits_at(self) -> tuple[str, ...]:
        """Where in the program each task waits that is not done."""
        return self.table._script.waiting

    def take_flow(self) -> list[tuple[str, str | None]]:
        """Parcels that came or left since the last call, each with its exit (None: it came)."""
        flow = [*self._flow]
        self._flow.clear()
        return flow

    def put(self, parcel: TableParcel, arrives: bool = True, *, lay_there: bool = False) -> None:
        """A parcel is on the table from now on; one that `arrives` is returned by `arrival`.

        It `lay_there` if it has not come within this run.
        """
        self.table._parcels[parcel.name] = parcel
        parcel._carried_by((self.table._move_by_program, self.table._leave_by_program))
        self.table.orders.on_parcel(parcel, lay_there=lay_there)
        if arrives:
            self.came += 1
            self._flow.append((parcel.name, None))
            self.table._arrived.append(parcel)

    def remove(self, name: str, exit: str | None = None, *, withdrawn: bool = False) -> None:
        """A parcel has left, by an exit unless it was lost, taken away, or never there."""
        parcel = self.table._parcels.pop(name)
        if withdrawn:
            self.table.orders.on_withdrawn(parcel)
        else:
            self.table.orders.on_left(parcel, exit)
        if exit is not None:
            self.left[exit] += 1
            self._flow.append((name, exit))
        parcel.has_left, parcel.withdrawn = True, withdrawn
        parcel._carried_by(None)
        parcel._see(None)
        if parcel in self.table._arrived:
            self.table._arrived.remove(parcel)

    def see(self, beliefs: Mapping[str, Belief]) -> None:
        """Take in the present beliefs of all parcels and of unknown things."""
        self.table._unknown = {
            name: (belief.pose, belief.outline)
            for name, belief in beliefs.items()
            if not belief.named
        }
        for name, parcel in self.table._parcels.items():
            parcel._see(beliefs.get(name))

    def step(self, step_s: float) -> BaseException | None:
        """Let a cycle pass, and the program go on; an error that ends it, if any."""
        self.table.now_s += step_s
        return self.table._script.step()

    def watch(self, now_s: Callable[[], float], on_blocked: Callable[[str, float], object]) -> None:
        """Measure by a clock how long the program computes.

        `on_blocked(where, took_s)` is called when that is too long for the table.
        """
        self.table._script.watch(now_s)
        self._on_blocked = on_blocked

    def take_blocked(self) -> list[tuple[str, float]]:
        """Where the program computed for too long since the last call, and how long [s]."""
        script = self.table._script
        blocked, script.blocked = script.blocked, []
        for where, took_s in blocked:
            self._on_blocked(where, took_s)
        return blocked

    def stop(self) -> BaseException | None:
        """Break off the program, and bring all parcels to rest; an error of that, if any."""
        self.table._traffic.stop()
        return self.table._script.cancel()

    def in_virtual_time(self) -> None:
        """Take signals from `receive` alone, from now on."""
        self.table._takes_signals = False

    def receive(self, name: str, value: Any) -> None:
        """A signal has come whose time is that of the run, or from the plant around the table."""
        self.table._waiting_under(name).append(value)


def _place_of(name: str, x_m: object, y_m: object) -> tuple[float, float]:
    farthest_m = PLACE["at_most"]
    wanted = f"a number from {-farthest_m:g} to {farthest_m:g}"

    def is_near(number: float) -> bool:
        return abs(number) <= farthest_m

    x_m = number_of(x_m, f"x_m of {name}", wanted, is_near)
    return x_m, number_of(y_m, f"y_m of {name}", wanted, is_near)


def gate_of(gates: Mapping[str, Gate], name: str) -> Gate:
    """The exit of that name. Raises ProgramError without one."""
    gate = gates.get(name) if isinstance(name, str) else None
    if gate is None:
        raise ProgramError(f"no exit {name!r}; there are: {', '.join(gates) or 'none'}")
    return gate


def _check_done(order: Order) -> None:
    """Raises ProgramError for an order that was refused."""
    if order.refused is not None:
        raise ProgramError(order.refused)


def _place(pose: Floats) -> tuple[float, float]:
    x_m, y_m, _ = pose.tolist()
    return x_m, y_m
