"""Tasks: the reward of a step, the end of an episode, and observations beside those of sensors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from typing import Any

import numpy as np

from mdms_array.learning.tables import Tables
from mdms_model.array import edge_m
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.errors import InputError
from mdms_model.run.record import is_wrong
from mdms_model.scenario.scenario import Scenario

#: A radian of a parcel's angle counts as much as so many metres of its place.
YAW_M_PER_RAD = 0.15
#: A parcel has reached its goal when it stands there to within this.
REACHED_M, REACHED_RAD, REACHED_M_S = 0.005, 0.05, 0.03


@dataclass(slots=True)
class Judgement:
    """The rewards of a step at N tables, and whether their episodes have ended."""

    reward: Floats
    ended: Bools
    infos: dict[str, Any] = field(default_factory=dict)


def as_seen(pose: Floats) -> Floats:
    """Poses (..., 3) as x, y, cosine and sine of the yaw (..., 4)."""
    seen = np.empty((*pose.shape[:-1], 4))
    seen[..., :2] = pose[..., :2]
    np.cos(pose[..., 2], out=seen[..., 2])
    np.sin(pose[..., 2], out=seen[..., 3])
    return seen


def wrapped(angle_rad: Floats) -> Floats:
    """Angles from -pi to pi."""
    return np.asarray((angle_rad + pi) % (2 * pi) - pi)


class ParcelTask:
    """The first parcel is to stand at its goal.

    A step is worth the way that it brings the parcel nearer to its goal [m], where a radian counts
    as 0.15 m. Reaching it is worth 1 more, tipping 1 less, and either ends the episode.
    """

    #: Shapes of the task's own observations.
    sizes: Mapping[str, tuple[int, ...]] = {"pose": (4,), "twist": (3,), "goal": (4,)}

    def __init__(self, scenario: Scenario, tables: int) -> None:
        _check_stays(scenario)
        self._goal, self._distance_m = np.zeros((tables, 3)), np.zeros(tables)
        self._goal_seen = as_seen(self._goal)

    def begin(self, k: int, scenario: Scenario, tables: Tables) -> None:
        """An episode of table k begins.

        Raises `InputError` for a parcel without a goal, or that does not stay.
        """
        _check_stays(scenario)
        goal = scenario.parcel[0].goal
        if goal is None:
            raise InputError(f"parcel {scenario.parcel[0].name!r} has no goal; give it one")
        self._goal[k] = goal.x_m, goal.y_m, goal.yaw_rad
        self._goal_seen[k] = as_seen(self._goal[k])
        self._distance_m[k] = self._errors(tables)[2][k]

    def _errors(self, tables: Tables) -> tuple[Floats, Floats, Floats]:
        """Errors of place [m] and angle [rad], and both as a distance [m]."""
        pose = tables.motion[0][:, 0]
        place_m = np.hypot(*(pose - self._goal)[:, :2].T)
        yaw_rad = abs(wrapped(pose[:, 2] - self._goal[:, 2]))
        return place_m, yaw_rad, place_m + YAW_M_PER_RAD * yaw_rad

    def judge(self, tables: Tables) -> Judgement:
        """Judge the step that all tables have made."""
        place_m, yaw_rad, distance_m = self._errors(tables)
        twist = tables.motion[1][:, 0]
        stands = abs(twist[:, 0]) + abs(twist[:, 1]) + YAW_M_PER_RAD * abs(twist[:, 2])
        reached = (place_m <= REACHED_M) & (yaw_rad <= REACHED_RAD) & (stands <= REACHED_M_S)
        fallen = tables.tipped
        reward = self._distance_m - distance_m + 1.0 * reached - 1.0 * fallen
        self._distance_m = distance_m
        infos: dict[str, Any] = {"reached": reached, "tipped": fallen}
        infos |= {"position_error_m": place_m, "yaw_error_rad": yaw_rad}
        return Judgement(reward, reached | fallen, infos)

    def seen(self, tables: Tables) -> dict[str, Floats]:
        """The task's own observations of all tables, (N, ...)."""
        pose, twist = tables.motion
        return {"pose": as_seen(pose[:, 0]), "twist": twist[:, 0], "goal": self._goal_seen}


def _check_stays(scenario: Scenario) -> None:
    """Raises `InputError` for a scenario without a parcel that stays on the table."""
    if scenario.exit or scenario.stream:
        raise InputError("parcels come or go in this scenario; take mdms/Sort-v0 for it")
    if not scenario.parcel:
        raise InputError("the scenario has no parcel; give it one, with a goal")


class SortTask:
    """Parcels that come are to leave by the exits for their kinds.

    A parcel that leaves by its exit is worth 1, by another -1; so is one that tips elsewhere, which
    ends the episode. A step is worth the way besides that parcels come nearer to the middles of
    their exits [m].
    """

    def __init__(self, scenario: Scenario, tables: int) -> None:
        parcels = len(scenario.parcel)
        self.sizes = {"on_table": (parcels,), "pose": (parcels, 4), "twist": (parcels, 3)}
        self.sizes |= {"exit_m": (parcels, 2)}
        #: Each table has the exits of its own scenario.
        self._exit_m = np.tile(_exits_m(scenario), (tables, 1, 1))
        self._left_m = np.zeros((tables, parcels))
        self._events: Ints = np.zeros(tables, np.int64)
        self._right, self._wrong = np.zeros((2, tables), np.int64)

    def begin(self, k: int, scenario: Scenario, tables: Tables) -> None:
        """See `ParcelTask`. Raises `InputError` for a scenario without exits or a stream."""
        self._exit_m[k] = _exits_m(scenario)
        self._events[k] = len(tables.worlds[k].events)
        self._right[k] = self._wrong[k] = 0
        self._left_m[k] = self._distances_m(tables)[k]

    def _distances_m(self, tables: Tables) -> Floats:
        """How far each parcel is from its exit (N, P) [m]; NaN for those that are away."""
        pose = tables.motion[0]
        return np.asarray(np.hypot(*np.moveaxis(pose[..., :2] - self._exit_m, -1, 0)))

    def judge(self, tables: Tables) -> Judgement:
        """See `ParcelTask`."""
        before = self._right - self._wrong
        for k, world in enumerate(tables.worlds):
            for event in world.events[self._events[k] :]:
                if event.kind == "exit":
                    (self._wrong if is_wrong(event) else self._right)[k] += 1
            self._events[k] = len(world.events)
        distances_m = self._distances_m(tables)
        # One that comes or goes has no way in this step.
        nearer_m = np.nansum(self._left_m - distances_m, axis=1)
        self._left_m = distances_m
        fallen = tables.tipped
        reward = nearer_m + (self._right - self._wrong - before) - 1.0 * fallen
        infos = {"sorted": self._right.copy(), "wrong": self._wrong.copy(), "tipped": fallen}
        return Judgement(reward, fallen, infos)

    def seen(self, tables: Tables) -> dict[str, Floats]:
        """See `ParcelTask`."""
        pose, twist = tables.motion
        here = ~np.isnan(pose[..., 0])
        poses, twists = (np.where(here[..., None], each, 0.0) for each in (as_seen(pose), twist))
        return {"on_table": 1.0 * here, "pose": poses, "twist": twists, "exit_m": self._exit_m}


def _exits_m(scenario: Scenario) -> list[Sequence[float]]:
    """The middle of each parcel's exit. Raises `InputError`."""
    if not scenario.exit or not scenario.stream:
        raise InputError("the scenario has no exit or no stream; take one such as sort54")
    return [_exit_m(scenario, parcel.kind) for parcel in scenario.parcel]


def _exit_m(scenario: Scenario, kind: str) -> Sequence[float]:
    """The middle of the exit for parcels of a kind, on the table's edge. Raises `InputError`."""
    for each in scenario.exit:
        if not each.kinds or kind in each.kinds:
            ends_m = edge_m(scenario.array, each.side, each.from_m, each.to_m)
            middle_m: list[float] = ends_m.mean(axis=0).tolist()
            return middle_m
    raise InputError(f"no exit takes parcels of kind {kind!r}; give one in exit.kinds")


#: A task of N tables.
LearningTask = ParcelTask | SortTask
