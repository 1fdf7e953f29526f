"""Where parcels are to go, in a scene: their goals, the ways there, and tiles reserved for them."""

from collections.abc import Hashable, Mapping

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.outline import outline_m
from mdms_model.run.colours import between, colours_of
from mdms_model.run.mcap.scene.primitives import Parts, block, colour, line
from mdms_model.run.planned import goals_at, plan_at
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Scenario

_GOAL_M, _WAY_M, _TILE_M = 0.004, 0.003, -0.003
_WIDTH_M, _CROSS_M = 0.005, 0.03
_TILE_OPACITY = 0.3
_INK = "#1c2733"


class Goals:
    """The outline of each parcel at its goal, with a cross in its middle."""

    topic, rate_hz = "/scene/goals", 30.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        self._scenario, self._record = scenario, record
        self._numbers = _numbers(scenario)
        self._colours = colours_of(scenario)

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        goals = goals_at(self._scenario, self._record, self._record.time_s[instant])
        return tuple((name, pose.tobytes()) for name, pose in goals.items())

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        goals = goals_at(self._scenario, self._record, self._record.time_s[instant])
        # One that somebody has named on the way is not known by its shape.
        known = (
            (self._numbers[name], goal) for name, goal in goals.items() if name in self._numbers
        )
        return {"lines": [each for goal in known for each in self._marks(*goal)]}

    def _marks(self, number: int, goal: Floats) -> list[dict[str, object]]:
        painted = colour(between(self._colours[number], _INK, 0.3))
        arms_m = _CROSS_M * np.array([[(-1, 0), (1, 0)], [(0, -1), (0, 1)]])
        marks = [
            line(goal[:2] + arm_m, _GOAL_M, _WIDTH_M, painted, closed=False) for arm_m in arms_m
        ]
        outline = outline_m(np.nan_to_num(goal), self._scenario.parcel[number])
        return [*marks, line(outline, _GOAL_M, _WIDTH_M, painted, closed=True)]


class Plans:
    """The ways of the plan in effect, and its tiles in the colour of the next parcel on each."""

    topic, rate_hz = "/scene/plans", 30.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        self._record = record
        self._numbers = _numbers(scenario)
        self._colours = colours_of(scenario)

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        plan = plan_at(self._record, self._record.time_s[instant])
        return None if plan is None else plan.time_s

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        plan = plan_at(self._record, self._record.time_s[instant])
        if plan is None:
            return {}
        lines = [
            line(poses[:, :2], _WAY_M, _WIDTH_M, self._paint(name), closed=False)
            for name, poses in plan.ways.items()
        ]
        tiles = [
            block(
                (round(tile.x_m, 5), round(tile.y_m, 5), _TILE_M),
                0.0,
                (tile.side_m, tile.side_m, 0.001),
                self._paint(tile.parcels[0], _TILE_OPACITY),
            )
            for tile in plan.tiles
            if tile.parcels
        ]
        return {"lines": lines, "cubes": tiles}

    def _paint(self, name: str, opacity: float = 1.0) -> dict[str, float]:
        number = self._numbers.get(name)
        return colour(_INK if number is None else self._colours[number], opacity)


def _numbers(scenario: Scenario) -> Mapping[str, int]:
    return {parcel.name: number for number, parcel in enumerate(scenario.parcel)}
