"""The table that an episode begins with: a scenario, with keys that are drawn for each episode."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mdms_array.experiments.settings import Distribution, check_apart, tree_of
from mdms_array.source import Source, open_source
from mdms_model.errors import InputError
from mdms_model.scenario.file import scenario_from
from mdms_model.scenario.rules import check_poses, check_starts
from mdms_model.scenario.scenario import Goal, Parcel, Scenario
from mdms_model.scenario.tree import build_values, plain

#: Keys of a parcel that are changed without a new table.
POSE = ("x_m", "y_m", "yaw_rad")
GOAL = "goal"
SEED = "run.seed"


def open_scenario(source: Source) -> Scenario:
    """A scenario from its name, its file, its tables, or itself. Raises `InputError`."""
    return source if isinstance(source, Scenario) else open_source(source)[0]


class Episodes:
    """Draws the scenario of an episode.

    `randomise` has keys of a scenario, with the distributions of a sweep or lists of values.
    Without `run.seed` among them, the spreads of motors and friction are the same in each episode.
    Raises `InputError`.
    """

    def __init__(self, scenario: Source, randomise: Mapping[str, Any]) -> None:
        self.base = open_scenario(scenario)
        self._tree = plain(self.base)
        if not isinstance(randomise, Mapping) or not all(isinstance(key, str) for key in randomise):
            raise InputError(
                f"randomise is {randomise!r}, but must be a dict by keys of a scenario; "
                "{} draws nothing"
            )
        self._randomise = dict(randomise)
        for key, values in self._randomise.items():
            listed = (
                isinstance(values, list | tuple | np.ndarray) and np.ndim(values) and len(values)
            )
            if not isinstance(values, Distribution) and not listed:
                raise InputError(
                    f"randomise: {key} is {values!r}, but must be a list of values or a "
                    "distribution, such as mdms_array.uniform(0.1, 0.3)"
                )
        check_apart(self._tree, self._randomise)
        self._names = [parcel.name for parcel in self.base.parcel]
        for key, values in self._randomise.items():
            if (place := self._pose_key(key)) is not None:
                for each in _ends_of_pose(key, values):
                    self._placed([(place, each)])
            if key == SEED:
                _check_seed(values)
        self.draw(np.random.default_rng(0))

    def draw(self, chance: np.random.Generator) -> Scenario:
        """The scenario of the next episode. Raises `InputError` for a value that none may have."""
        setting = {key: _drawn(values, chance) for key, values in self._randomise.items()}
        seed = int(setting.pop(SEED, self.base.run.seed))
        placed = {key: self._pose_key(key) for key in setting}
        if seed == self.base.run.seed and all(placed.values()):
            pairs = [(place, setting[key]) for key, place in placed.items() if place]
            scenario = self._placed(pairs)
            check_starts(scenario)
            return scenario
        return scenario_from(tree_of(self._tree, setting, seed))

    def _pose_key(self, key: str) -> tuple[int, bool, str] | None:
        """Parcel, whether of its goal, and name, of a key of a pose; None for any other key."""
        head, _, rest = key.partition(".")
        name, _, rest = rest.rpartition(".goal.") if ".goal." in rest else rest.rpartition(".")
        if head != "parcel" or rest not in POSE:
            return None
        if name.isdecimal() and int(name) < len(self._names):
            number = int(name)
        elif name in self._names:
            number = self._names.index(name)
        else:
            return None
        return number, ".goal." in key, rest

    def _placed(self, changes: list[tuple[tuple[int, bool, str], Any]]) -> Scenario:
        """The base with other poses. Raises `ScenarioError` for one off the table."""
        parcels: list[Parcel] = [*self.base.parcel]
        for (number, of_goal, name), value in changes:
            parcel = parcels[number]
            if of_goal:
                goal = replace(parcel.goal or Goal(0.0, 0.0), **{name: float(value)})
                parcels[number] = replace(parcel, goal=goal)
            else:
                changed: dict[str, Any] = {name: float(value)}
                parcels[number] = replace(parcel, **changed)
        scenario = replace(self.base, parcel=tuple(parcels))
        check_poses(scenario)
        return scenario


def _ends_of_pose(key: str, values: Any) -> list[Any]:
    """The values of a place or an angle that may be drawn: a list's, or a distribution's ends.

    Raises `ScenarioError` for one that no scenario has.
    """
    path, _, name = key.rpartition(".")
    ends = (values.low, values.high) if isinstance(values, Distribution) else values
    plain_ends = [each.item() if hasattr(each, "item") else each for each in ends]
    for each in plain_ends:
        build_values(Goal, {name: each}, path)
    return plain_ends


def _check_seed(values: Any) -> None:
    """Raises `InputError` for seeds that are no whole numbers."""
    if isinstance(values, Distribution):
        is_whole = values.kind == "integers"
    else:
        is_whole = all(isinstance(each, int | np.integer) for each in values)
    if not is_whole:
        raise InputError(
            f"randomise: {SEED} is {values}, but must be whole numbers; take mdms_array.integers"
        )


def _drawn(values: Any, chance: np.random.Generator) -> Any:
    if isinstance(values, Distribution):
        return values.at(float(chance.random()))
    each = values[int(chance.integers(len(values)))]
    # Numbers of numpy become those of Python, as a scenario has them.
    return each.item() if isinstance(each, np.generic) else each
