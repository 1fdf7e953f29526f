"""The tasks of a program file as a program."""

from collections.abc import Callable, Coroutine, Iterator, Sequence
from typing import Any

from mdms_host.programs import tasks
from mdms_host.programs.program import Main
from mdms_host.programs.table import Newcomer, ProgramError, Table
from mdms_model.scenario.scenario import Task


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
    return tasks.transport(table, table[task.parcel], *_place(task), task.yaw_rad)


def _name(table: Table, task: Task) -> Coroutine[Any, Any, None]:
    newcomer = Newcomer(
        task.parcel, task.length_m, task.width_m, task.shape, task.kind, task.mass_kg
    )
    return tasks.name(table, newcomer, *_place(task))


def _place(task: Task) -> tuple[float, float]:
    if task.x_m is None or task.y_m is None:
        raise ProgramError(f"{task.do} of {task.parcel} has no place")
    return task.x_m, task.y_m


_ROUTINES: dict[str, Callable[[Table, Task], Coroutine[Any, Any, None]]] = {
    "transport": _transport,
    "name": _name,
    "swap": lambda table, task: tasks.swap(table, *(table[name] for name in task.parcels)),
    "sort": lambda table, task: tasks.sort(table, task.count),
    "merge": lambda table, task: tasks.merge(table, task.exit, task.count),
    "singulate": lambda table, task: tasks.singulate(table, task.exit, task.period_s, task.count),
    "buffer": lambda table, task: tasks.buffer(
        table, task.places, task.exit, task.order, task.count
    ),
    "wait": lambda table, task: table.sleep(task.period_s),
}
