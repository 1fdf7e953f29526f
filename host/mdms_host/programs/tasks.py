"""The usual jobs of a table: one coroutine a task, and the tasks of a file as a program."""

from collections import deque
from collections.abc import Callable, Coroutine, Iterator, Sequence
from typing import Any, cast

from mdms_host.programs.program import Main
from mdms_host.programs.script import Outside, ScriptTask, until
from mdms_host.programs.table import Newcomer, ProgramError, Table, TableParcel, gate_of
from mdms_model.scenario.scenario import Task

__all__ = ["Buffer", "buffer", "merge", "name", "singulate", "sort", "swap", "transport"]

Place = tuple[float, float]


async def transport(
    table: Table, parcel: TableParcel, x_m: float, y_m: float, yaw_rad: float | None = None
) -> None:
    """Carry a parcel to a place; turned so there, if a yaw is given: position and orient."""
    await parcel.move(x_m, y_m, yaw_rad)


async def name(table: Table, newcomer: Newcomer, x_m: float, y_m: float) -> None:
    """Give a name to the unknown thing at a place, as soon as one lies there."""
    await until(lambda: table.unknown_at(x_m, y_m) is not None)
    await table.name(newcomer, x_m, y_m)


async def swap(table: Table, one: TableParcel, other: TableParcel) -> None:
    """Two parcels change places; each is turned there as the other was, if both can be turned."""
    (x_m, y_m, yaw_rad), (other_x_m, other_y_m, other_yaw_rad) = one.pose, other.pose
    turns = not (one.is_round or other.is_round)
    await table.together(
        one.move(other_x_m, other_y_m, other_yaw_rad if turns else None),
        other.move(x_m, y_m, yaw_rad if turns else None),
    )


async def sort(table: Table, count: int | None = None) -> None:
    """Each parcel that comes leaves by the exit for its kind; so many, or without end."""
    await _all_leave(table, None, count)


async def merge(table: Table, exit: str, count: int | None = None) -> None:
    """Parcels that come, at any place, leave by one exit; so many, or without end.

    The plan settles the order where their ways meet, as for all parcels.
    """
    await _all_leave(table, exit, count)


async def _all_leave(table: Table, exit: str | None, count: int | None) -> None:
    leaving: list[ScriptTask[None]] = []
    missing = count
    while missing is None or missing > 0:
        came: list[TableParcel] = []
        async for parcel in table.arrivals(missing):
            leaving = [task for task in leaving if not task.done]
            leaving.append(table.start(parcel.leave(exit)))
            if count is not None:
                came.append(parcel)
        for task in leaving:
            await task
        missing = sum(parcel.withdrawn for parcel in came)


async def singulate(
    table: Table, exit: str, period_s: float = 0.0, count: int | None = None
) -> None:
    """Parcels leave by an exit one at a time, each when the one before has left.

    Those that lie on the table go first, the nearest to the exit before all others, then those that
    come. `count` counts both; a parcel sets out `period_s` after the one before or later.
    """
    gate = gate_of(table.gates, exit)
    lying = sorted(
        (parcel for parcel in table.parcels if parcel.found),
        key=lambda parcel: -gate.out_m(*parcel.pose[:2]),
    )
    left = 0
    while count is None or left < count:
        parcel = lying.pop(0) if lying else await table.arrival()
        if parcel.has_left:
            continue
        due_s = table.now_s + period_s
        await parcel.leave(exit)
        if table.now_s < due_s:
            await table.sleep(due_s - table.now_s)
        left += not parcel.withdrawn


class Buffer:
    """Places at which parcels wait until they are asked for; first in, first out.

    A parcel that has left otherwise, was found by mistake, or does not come to its place frees the
    place: it was refused its way, or the task of its `put` was broken off. Raises ProgramError for
    no places, or one that is given twice.
    """

    def __init__(self, table: Table, places: Sequence[Place]) -> None:
        # Arrays of numpy are not equal to each other as places are.
        places = cast("list[Place]", [tuple(place) for place in places])
        if not places:
            raise ProgramError("a buffer needs places for parcels to wait at")
        if len(set(places)) < len(places):
            raise ProgramError(f"a buffer has one of {places} twice; give each place once")
        self._table = table
        self._free: deque[Place] = deque(places)
        self._waiting: dict[str, tuple[TableParcel, Place]] = {}

    @property
    def parcels(self) -> tuple[TableParcel, ...]:
        """Those in it or on their way into it, the first first."""
        self._forget_left()
        return tuple(parcel for parcel, _ in self._waiting.values())

    @property
    def is_full(self) -> bool:
        """Whether every place is taken."""
        self._forget_left()
        return not self._free

    async def put(self, parcel: TableParcel) -> None:
        """Bring a parcel to a free place, as soon as there is one; returns when it is there.

        One that has a place goes to that. Raises ProgramError when it cannot come there.
        """
        await until(lambda: parcel.has_left or parcel in self.parcels or not self.is_full)
        if parcel.has_left:
            return
        if parcel not in self.parcels:
            self._waiting[parcel.name] = parcel, self._free.popleft()
        _, place = self._waiting[parcel.name]
        try:
            await parcel.move(*place)
        except (ProgramError, GeneratorExit):
            if self._waiting.get(parcel.name) == (parcel, place):
                del self._waiting[parcel.name]
                self._free.append(place)
            raise

    async def take(self, exit: str | None = None, name: str | None = None) -> TableParcel:
        """Have the first parcel leave, or that of a name or kind, once it is in the buffer.

        Returns it when it has left; its place is free as soon as it sets out. Raises ProgramError
        when it cannot leave. It is the first in its place then, if that has not been given away.
        """
        await until(Outside(lambda: self._wanted(name) is not None))
        wanted = self._wanted(name)
        assert wanted is not None
        _, place = self._waiting.pop(wanted.name)
        self._free.append(place)
        try:
            await wanted.leave(exit)
        except (ProgramError, GeneratorExit):
            if place in self._free:
                self._free.remove(place)
                self._waiting = {wanted.name: (wanted, place), **self._waiting}
            raise
        return wanted

    def _forget_left(self) -> None:
        for name, (parcel, place) in list(self._waiting.items()):
            if parcel.has_left:
                del self._waiting[name]
                self._free.append(place)

    def _wanted(self, name: str | None) -> TableParcel | None:
        fits = (one for one in self.parcels if name is None or name in (one.name, one.kind))
        return next(fits, None)


async def buffer(
    table: Table,
    places: Sequence[Place],
    exit: str,
    order: Sequence[str] = (),
    count: int | None = None,
) -> None:
    """Parcels that come wait at places [m; table frame], and leave by an exit.

    First in, first out: the first leaves when all places are taken, and at the end all that are
    left. With an `order` they leave in that order of names or kinds instead, and it ends with it.
    """
    store = Buffer(table, places)
    if order:
        filling = table.start(_fill(table, store, count))
        for name in order:
            # One that was found by mistake is to be another one.
            while (await store.take(exit, name)).withdrawn:
                pass
        filling.cancel()
        return
    missing = count
    while missing is None or missing > 0:
        missing = await _fill_and_empty(table, store, exit, missing)


async def _fill_and_empty(table: Table, store: Buffer, exit: str, count: int | None) -> int:
    """Let so many parcels come and leave; returns how many of them were found by mistake."""
    came: list[TableParcel] = []
    async for parcel in table.arrivals(count):
        if store.is_full:
            await store.take(exit)
        put = table.start(store.put(parcel))
        if count is not None:
            came.append(parcel)
    # The last one is in it from the first turn of its task on.
    await until(lambda: bool(store.parcels) or put.done)
    while store.parcels:
        await store.take(exit)
    return sum(parcel.withdrawn for parcel in came)


async def _fill(table: Table, store: Buffer, count: int | None) -> None:
    """Put so many parcels into a buffer, or all that come; in place of a withdrawn one another."""
    came: list[TableParcel] = []
    puts: list[ScriptTask[None]] = []
    try:
        while True:
            await until(lambda: count is None or sum(not each.withdrawn for each in came) < count)
            parcel = await table.arrival()
            puts = [put for put in puts if not put.done]
            puts.append(table.start(store.put(parcel)))
            if count is not None:
                came.append(parcel)
    finally:
        # The order is done: nobody waits for those that are still on their way.
        for put in puts:
            put.cancel()


def main_of(listed: Sequence[Task]) -> Main:
    """The program that does these tasks; those `beside` another go on together with it."""
    groups = list(_groups(listed))

    async def main(table: Table) -> None:
        for group in groups:
            await table.together(*(_routine(table, task) for task in group))

    return main


def _groups(listed: Sequence[Task]) -> Iterator[list[Task]]:
    group: list[Task] = []
    for task in listed:
        if group and not task.beside:
            yield group
            group = []
        group.append(task)
    if group:
        yield group


def _routine(table: Table, task: Task) -> Coroutine[Any, Any, None]:
    """The coroutine of a task; its keys have been checked by `mdms_model.scenario.run_rules`."""
    return _ROUTINES[task.do](table, task)


def _transport(table: Table, task: Task) -> Coroutine[Any, Any, None]:
    return transport(table, table[task.parcel], *_place(task), task.yaw_rad)


def _name(table: Table, task: Task) -> Coroutine[Any, Any, None]:
    newcomer = Newcomer(
        task.parcel, task.length_m, task.width_m, task.shape, task.kind, task.mass_kg
    )
    return name(table, newcomer, *_place(task))


def _place(task: Task) -> tuple[float, float]:
    if task.x_m is None or task.y_m is None:
        raise ProgramError(f"{task.do} of {task.parcel} has no place")
    return task.x_m, task.y_m


_ROUTINES: dict[str, Callable[[Table, Task], Coroutine[Any, Any, None]]] = {
    "transport": _transport,
    "name": _name,
    "swap": lambda table, task: swap(table, *(table[name] for name in task.parcels)),
    "sort": lambda table, task: sort(table, task.count),
    "merge": lambda table, task: merge(table, task.exit, task.count),
    "singulate": lambda table, task: singulate(table, task.exit, task.period_s, task.count),
    "buffer": lambda table, task: buffer(table, task.places, task.exit, task.order, task.count),
    "wait": lambda table, task: table.sleep(task.period_s),
}
