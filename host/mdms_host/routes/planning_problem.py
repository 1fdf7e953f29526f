"""The problem of one parcel, the data for its plan, and why it has no route.

The data are its way map and the tiles that it is on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import degrees, floor

import numpy as np

from mdms_host.motion.trajectory.path import shorter_turn_rad
from mdms_host.routes.grid import Tiles
from mdms_host.routes.interval_search import FoundWay
from mdms_host.routes.moves import LatticeMoves
from mdms_host.routes.roadmap import Roadmap
from mdms_host.routes.route import Pace, Route, Visits, among, merged
from mdms_host.routes.support import Shape, ShapeSupport
from mdms_model.arrays import Bools, Floats, Ints

#: Poses that are this near are one [m, m, rad].
_SAME = 1e-7
#: A turn this little less than a whole number of turns counts as that number [turns].
_WHOLE = 1e-9


@dataclass(frozen=True, eq=False)
class RouteTask:
    """A parcel on the table, and its goal; without a goal it stays at its place.

    Start and goal are (x, y, yaw); a disc's yaw does not matter. A parcel that `leaves` is taken
    off the table at its goal, `leaves_s` after it has come.
    """

    parcel: str
    shape: Shape
    start: Floats
    goal: Floats | None = None
    leaves: bool = False
    leaves_s: float = 0.5


@dataclass(frozen=True, eq=False)
class Ground:
    """Data that all problems of a table share."""

    tiles: Tiles
    pace: Pace
    clearance_m: float
    hangs: bool = False
    """Whether ways may hang over the edge of the table as far as the rim of tiles."""

    def stand(self, shape: Shape, pose: Floats) -> Ints:
        """The tiles under a parcel at a pose, those beyond the rim left out."""
        return self.tiles.swept(shape.body, pose[None], pose[None], self.clearance_m).tile


@dataclass(eq=False)
class PlanningProblem:
    """A task with its way map, in yaws of its own: turned by `turned_rad` they are true."""

    task: RouteTask
    ground: Ground
    ways: LatticeMoves
    standing: ShapeSupport
    turned_rad: float
    now_s: float
    so_far: Route | None = None
    """The part that is planned already: a way aside, from the end of which it goes on."""
    stand: Ints = field(init=False)
    """Tiles it is on where its route begins to be planned."""

    def __post_init__(self) -> None:
        self.stand = self.ground.stand(self.task.shape, self.task.start)

    @cached_property
    def roadmap(self) -> Roadmap:
        """Start and goal joined to the lattice."""
        start, goal = own_ends(self.task, self.turned_rad)
        ground, leaves = self.ground, self.task.leaves
        return Roadmap(self.ways, self.standing, ground.pace, start, goal, leaves, ground.hangs)

    @cached_property
    def goal_stand(self) -> Ints:
        """Tiles it is on at its goal; none if it leaves the table there or has no goal."""
        if self.task.goal is None or self.task.leaves:
            return np.zeros(0, dtype=np.int64)
        return self.ground.stand(self.task.shape, self.task.goal)

    @cached_property
    def prefix(self) -> Route:
        """Its route until it can be planned anew; it stays at the end."""
        if self.so_far is not None:
            return self.so_far
        return self._route(self.task.start[None], self.now_s, np.zeros(0), np.inf)

    @property
    def is_at_rest(self) -> bool:
        """Whether it is where it can be planned anew."""
        return self.so_far is None

    @property
    def ready_s(self) -> float:
        """When it is where it can be planned anew [s]."""
        return self.now_s if self.is_at_rest else max(self.prefix.end_s, self.now_s)

    def route(self, found: FoundWay) -> Route:
        """The route along the result of a search."""
        ahead = [self.roadmap.pose(node) for node in found.nodes[1:].tolist()]
        turned = np.array(ahead).reshape(-1, 3) + np.array([0.0, 0.0, self.turned_rad])
        poses = np.concatenate([self.prefix.poses, turned])
        end_s = float(found.arrives_s[-1]) if len(found.arrives_s) else self.ready_s
        gone_s = end_s + self.task.leaves_s if self.task.leaves else np.inf
        before_s = np.zeros(0) if self.so_far is None else self.so_far.begins_s
        begins_s = np.concatenate((before_s, found.begins_s))
        return self._route(poses, self.now_s, begins_s, gone_s)

    def along(self, poses: Floats, begins_s: Floats) -> Route:
        """The route along these poses, with moves that begin then, to the end of the problem."""
        route = self._route(poses, self.now_s, begins_s, np.inf)
        if not self.task.leaves:
            return route
        return self._route(poses, self.now_s, begins_s, route.end_s + self.task.leaves_s)

    def _route(self, poses: Floats, now_s: float, planned_s: Floats, gone_s: float) -> Route:
        """A route along poses; its last moves begin as planned, those before them at once."""
        kept = np.ones(len(poses), dtype=bool)
        kept[1:] = (np.abs(np.diff(poses, axis=0)) > _SAME).any(axis=1)
        begins_s = np.full(len(poses) - 1, -np.inf)
        begins_s[len(begins_s) - len(planned_s) :] = planned_s
        poses, begins_s = poses[kept], begins_s[kept[1:]]
        body, pace = self.task.shape.body, self.ground.pace
        ways = np.diff(poses, axis=0)
        lengths_m, turns_m = np.hypot(ways[:, 0], ways[:, 1]), np.abs(ways[:, 2]) * body.bend_m
        ways_m = np.hypot(lengths_m, turns_m)
        along_m = np.concatenate(([0.0], np.cumsum(ways_m)))
        lasts_s = pace.times_s(lengths_m, turns_m, np.ones(len(ways)))
        arrives_s, ready_s = np.empty(len(ways)), now_s
        for index, last_s in enumerate(lasts_s.tolist()):
            begins_s[index] = max(begins_s[index], ready_s)
            arrives_s[index] = ready_s = begins_s[index] + last_s
        met = self.ground.tiles.swept(body, poses[:-1], poses[1:], self.ground.clearance_m)
        move = np.repeat(np.arange(len(ways)), np.diff(met.first))
        own = lengths_m[move], turns_m[move]
        visits = Visits(
            met.tile,
            along_m[move] + met.enters * ways_m[move],
            along_m[move] + met.leaves * ways_m[move],
            begins_s[move] + pace.times_s(*own, met.enters),
            begins_s[move] + pace.times_s(*own, met.leaves),
        )
        stand = self.ground.stand(self.task.shape, poses[-1])
        waits = np.flatnonzero(begins_s[1:] > arrives_s[:-1]) + 1
        rests = [(along_m[k], self.ground.stand(self.task.shape, poses[k])) for k in waits.tolist()]
        if not len(ways):
            zeros = np.zeros(len(stand))
            visits = Visits(stand, zeros, zeros, zeros + now_s, zeros + now_s)
        visits = merged(visits, rests, stand, along_m[-1], gone_s)
        # Where it stands at the start it has been before; a turn sweeps more as it begins.
        begin = self.ground.stand(self.task.shape, poses[0])
        visits.enters_s[(visits.enters_m <= 0.0) & among(visits.tile, begin)] = -np.inf
        return Route(
            self.task.parcel,
            poses,
            along_m,
            begins_s,
            arrives_s,
            visits,
            self.task.shape.body.bend_m,
        )

    def aside(self, pose: Floats) -> "PlanningProblem":
        """The same parcel on its way to another place."""
        task = replace(self.task, goal=pose, leaves=False)
        return replace(self, task=task)

    def staying(self) -> "PlanningProblem":
        """The same parcel where it stays as one without a goal."""
        return replace(self, task=replace(self.task, goal=None, leaves=False))

    def onward(self, route: Route) -> "PlanningProblem":
        """The same problem from the end of its planned part."""
        return replace(self, task=replace(self.task, start=route.poses[-1]), so_far=route)


def own_ends(task: RouteTask, turned_rad: float) -> tuple[Floats, Floats]:
    """Start and goal turned back by so much, the goal's by the shorter turn from the start's."""
    start = task.start - [0.0, 0.0, turned_rad]
    goal = start if task.goal is None else np.array(task.goal, dtype=np.float64)
    turn_rad = 0.0 if task.shape.round else shorter_turn_rad(task.start[2], goal[2])
    if task.goal is None:
        return start, start
    return start, np.array([goal[0], goal[1], start[2] + turn_rad])


def turned_rad(task: RouteTask) -> float:
    """The yaw that planning takes for 0: of a disc its own, else by turns that change nothing.

    By as many that the least yaw of the lattice is soon above 0, so that few lattices are needed.
    """
    if task.shape.round:
        return float(task.start[2])
    start, goal = own_ends(task, 0.0)
    least_rad = task.shape.yaws_rad(float(start[2]), float(goal[2]))[0]
    return floor(least_rad / task.shape.period_rad + _WHOLE) * task.shape.period_rad


@dataclass(frozen=True, eq=False)
class Blocker:
    """A parcel that is in the way, at its place or at its goal."""

    parcel: str
    at: str
    pose: Floats

    def __str__(self) -> str:
        return f"{self.parcel!r} at its {self.at} {place(self.pose)}"


@dataclass(frozen=True, eq=False)
class Blocked:
    """A parcel without a route. `by` are the fewest parcels, without which it would have one.

    If there are none, `closed` is whether closed cells are in the way, and `passing` whether
    parcels that are under way are. If neither is, its start or goal cannot be left or reached on
    this table at all.
    """

    parcel: str
    start: Floats
    goal: Floats | None
    by: tuple[Blocker, ...] = ()
    closed: bool = False
    passing: bool = False

    @property
    def may_pass(self) -> bool:
        """Whether the obstacle may go away."""
        return bool(self.by) or self.closed or self.passing

    @property
    def way(self) -> str:
        """Which way there is none of, in words."""
        goal = "" if self.goal is None else f" to its goal {place(self.goal)}"
        return f"parcel {self.parcel!r} has no way from {place(self.start)}{goal}"

    def __str__(self) -> str:
        way = self.way
        if self.by:
            names = " and ".join(map(str, self.by))
            return f"{way}: blocked by {names}; clear the way, or give another goal"
        if self.closed:
            return f"{way}: blocked by closed cells; give a goal that is reached around them"
        if self.passing:
            return f"{way}: parcels that are under way are before it"
        return (
            f"{way}: on this table it would hang over the edge or tip, at its start, at its goal "
            "or between; give a goal farther from the edge"
        )


def place(pose: Floats) -> str:
    """A pose as a person reads it."""
    return f"({pose[0]:.3f} m, {pose[1]:.3f} m, {degrees(pose[2]):.0f} degrees)"


def blockers(
    places: Sequence[tuple[Blocker, Ints]], closed: Bools, free: Callable[[Bools], bool]
) -> tuple[tuple[Blocker, ...], bool, bool]:
    """The bars of a way: places, none of them in vain, or closed tiles, or nothing for good.

    The result is the places, whether closed tiles bar the way, and whether nothing does for good.
    `free` returns whether there is a way past these tiles.
    """
    if not free(closed):
        return (), bool(closed.any()) and free(closed & False), False
    blocked, by = closed.copy(), []
    for blocker, tiles in places:
        more = blocked.copy()
        more[tiles] = True
        if free(more):
            blocked = more
        else:
            by.append(blocker)
    return tuple(by), False, not by
