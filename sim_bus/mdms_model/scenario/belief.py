"""What the host takes for true of a scenario where it is not: its `[belief]` table."""

from dataclasses import replace
from typing import Any

from mdms_model.scenario.scenario import Cell, Parcel, Scenario, ScenarioError
from mdms_model.scenario.tree import build_values

#: What a parcel is called and where it is to go is no belief.
_GIVEN = ("name", "goal")


def believed(scenario: Scenario) -> Scenario:
    """The scenario as the host takes it to be: the keys of `[belief]` in place of the truth's.

    Tables in it are parcels by name, all else are keys of `[cell]`. Raises `ScenarioError`.
    """
    named = {parcel.name: parcel for parcel in scenario.parcel}
    own = {key: value for key, value in scenario.belief.items() if not isinstance(value, dict)}
    cell = replace(scenario.cell, **build_values(Cell, own, "belief"))
    for name, keys in scenario.belief.items():
        if name not in own:
            named[name] = _parcel(named, name, keys)
    return replace(scenario, cell=cell, parcel=tuple(named.values()), belief={})


def _parcel(named: dict[str, Parcel], name: str, keys: dict[str, Any]) -> Parcel:
    path = f"belief.{name}"
    if name not in named:
        raise ScenarioError(f"{path}: no parcel has that name; there are {', '.join(named)}")
    for key in _GIVEN:
        if key in keys:
            raise ScenarioError(f"{path}.{key} cannot differ from the parcel's own; leave it out")
    return replace(named[name], **build_values(Parcel, keys, path))
