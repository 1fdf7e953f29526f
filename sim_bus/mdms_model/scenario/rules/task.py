"""Rules of the values of a task, by its job and its table."""

import dataclasses
from collections.abc import Mapping

from mdms_model.scenario.rules.on_table import check_over, half_table_m
from mdms_model.scenario.scenario import Scenario, ScenarioError, in_stock, name_fault
from mdms_model.scenario.task import Task

#: What each kind of task needs, and what it may have besides.
NEEDED: Mapping[str, tuple[str, ...]] = {
    "transport": ("parcel", "x_m", "y_m"),
    "name": ("parcel", "x_m", "y_m"),
    "swap": ("parcels",),
    "sort": (),
    "merge": ("exit",),
    "singulate": ("exit",),
    "buffer": ("exit", "places"),
    "wait": ("period_s",),
}
ALLOWED: Mapping[str, tuple[str, ...]] = {
    "transport": ("yaw_rad",),
    "name": ("length_m", "width_m", "mass_kg", "shape", "kind"),
    "swap": (),
    "sort": ("count",),
    "merge": ("count",),
    "singulate": ("period_s", "count"),
    "buffer": ("order", "count"),
    "wait": (),
}
_EMPTY = {item.name: item.default for item in dataclasses.fields(Task)}


def check_tasks(scenario: Scenario) -> None:
    """Refuse tasks that cannot be done. Raises `ScenarioError` with the key's full path."""
    programmed = scenario.motion.field == "program"
    if scenario.task and not programmed:
        raise ScenarioError(
            f"task is given, but motion.field is {scenario.motion.field!r}; set it to 'program'"
        )
    if programmed and scenario.run.fidelity != "firmware":
        raise ScenarioError(
            f"motion.field is 'program', but run.fidelity is {scenario.run.fidelity!r}; "
            "a program needs the cells' sensors, so set run.fidelity to 'firmware'"
        )
    for number, task in enumerate(scenario.task):
        key = f"task.{number}"
        _check_keys(task, key)
        named = [each.parcel for each in scenario.task[:number] if each.do == "name"]
        _check_names(scenario, task, key, named)
        _check_places(scenario, task, key)
        if task.beside and not number:
            raise ScenarioError(f"{key}.beside is true, but no task comes before it; leave it out")


def _check_keys(task: Task, key: str) -> None:
    needed, known = NEEDED[task.do], (*NEEDED[task.do], *ALLOWED[task.do])
    for name, empty in _EMPTY.items():
        given = getattr(task, name) != empty
        if name in needed and not given:
            raise ScenarioError(f"{key}.{name} is missing, which {task.do!r} needs")
        if given and name not in (*known, "do", "beside"):
            raise ScenarioError(
                f"{key}.{name} is given, but {task.do!r} has only {', '.join(known) or 'no keys'}"
            )


def _check_names(scenario: Scenario, task: Task, key: str, named: list[str]) -> None:
    """Parcels lie on the table, or have been `named` by a task before; exits are there."""
    lying = [each.name for each in scenario.parcel if each.name not in in_stock(scenario)]
    lying += named
    if task.do == "name" and (fault := name_fault(task.parcel)):
        raise ScenarioError(f"{key}.parcel is {task.parcel!r}, but {fault}")
    names = [("parcel", task.parcel)] if task.parcel and task.do != "name" else []
    names += [(f"parcels.{item}", name) for item, name in enumerate(task.parcels)]
    for name, parcel in names:
        if parcel not in lying:
            raise ScenarioError(
                f"{key}.{name} is {parcel!r}, but must be a parcel that lies on the table: "
                f"{', '.join(lying) or 'there is none'}"
            )
    if task.do == "swap" and len(set(task.parcels)) != 2:
        raise ScenarioError(f"{key}.parcels is {list(task.parcels)}, but must be two parcels")
    exits = [each.name for each in scenario.exit]
    if task.exit and task.exit not in exits:
        raise ScenarioError(
            f"{key}.exit is {task.exit!r}, but must be one of {', '.join(exits) or 'exit: none'}"
        )
    if task.do == "sort":
        _check_sorted(scenario, key)


def _check_sorted(scenario: Scenario, key: str) -> None:
    """Every kind that comes has an exit."""
    stock, sorted_ = in_stock(scenario), {kind for each in scenario.exit for kind in each.kinds}
    for parcel in scenario.parcel:
        if parcel.name in stock and parcel.kind not in sorted_:
            raise ScenarioError(
                f"{key} is to sort {parcel.name!r} by its kind, {parcel.kind!r}, but no exit has "
                "that kind; give it to one, as in exit.0.kinds"
            )


def _check_places(scenario: Scenario, task: Task, key: str) -> None:
    places = [(f"places.{item}", place) for item, place in enumerate(task.places)]
    if task.x_m is not None and task.y_m is not None:
        places = [("", (task.x_m, task.y_m))]
    for name, place in places:
        for axis, half_m in enumerate(half_table_m(scenario)):
            path = f"{key}.{name}.{axis}" if name else f"{key}.{'xy'[axis]}_m"
            check_over(path, "the place", place[axis], place[axis], half_m)
