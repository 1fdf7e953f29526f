"""The host's beliefs that differ from the scenario: its `[belief]` table."""

from dataclasses import dataclass, replace
from typing import Any

from mdms_model.scenario.scenario import Cell, Parcel, Scenario, ScenarioError
from mdms_model.scenario.tree import build_values

#: A parcel's name and its goal are no belief.
_GIVEN = ("name", "goal")


@dataclass(frozen=True, slots=True)
class _Given:
    """Data of a parcel for the host, apart from its kind: whether it is told of it at all."""

    known: bool = True


def believed(scenario: Scenario) -> Scenario:
    """The scenario as the host takes it to be: the keys of `[belief]` in place of the truth's.

    Tables in it are parcels by name, all else are keys of `[cell]`. A parcel that is not `known` is
    left out: it lies there, and nobody has said so. Raises `ScenarioError`.
    """
    named = {parcel.name: parcel for parcel in scenario.parcel}
    own = {key: value for key, value in scenario.belief.items() if not isinstance(value, dict)}
    cell = replace(scenario.cell, **build_values(Cell, own, "belief"))
    for name, keys in scenario.belief.items():
        if name in own:
            continue
        parcel = _parcel(named, name, keys)
        if _is_known(parcel, keys):
            named[name] = parcel
        else:
            del named[name]
    return replace(scenario, cell=cell, parcel=tuple(named.values()), belief={})


def _parcel(named: dict[str, Parcel], name: str, keys: dict[str, Any]) -> Parcel:
    path = f"belief.{name}"
    if name not in named:
        raise ScenarioError(f"{path}: no parcel has that name; there are {', '.join(named)}")
    for key in _GIVEN:
        if key in keys:
            raise ScenarioError(f"{path}.{key} cannot differ from the parcel's own; leave it out")
    told = {key: value for key, value in keys.items() if key != "known"}
    return replace(named[name], **build_values(Parcel, told, path))


def _is_known(parcel: Parcel, keys: dict[str, Any]) -> bool:
    """Whether the host is told of a parcel. If it is not, there can be no other key."""
    path = f"belief.{parcel.name}"
    told = {key: value for key, value in keys.items() if key == "known"}
    if _Given(**build_values(_Given, told, path)).known:
        return True
    if len(keys) > 1:
        other = next(key for key in keys if key != "known")
        raise ScenarioError(f"{path}.known is false, so that {path}.{other} means nothing")
    if parcel.goal is not None:
        raise ScenarioError(
            f"{path}.known is false, but the parcel has a goal, and the host is to steer it there"
        )
    return False
