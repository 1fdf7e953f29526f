"""Better routes once all have theirs: fewer corners, and times that follow from the truth.

A search goes along its lattice and comes to rest where others pass. Once all have their routes,
most of its corners can be cut: the parcel goes straight while the tiles of that way are free.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from mdms_host.motion.trajectory.path import Path
from mdms_host.routes.interval_search import Taken, first_departure, free_until
from mdms_host.routes.moves import Met
from mdms_host.routes.planning_problem import PlanningProblem
from mdms_host.routes.reservations import REST_M, Reservations, Wait
from mdms_host.routes.route import Pace, Route, Visits
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.compiled import compiled

#: A parcel hangs over the edge of the table by no more than a hair on a way that is cut [m].
_HAIR_M = 1e-6


class Move(NamedTuple):
    """A straight move from rest to rest, which takes so long, and the tiles that it meets."""

    lasts_s: float
    met: Met


class Leg(NamedTuple):
    """A straight part of a way: the poses that its moves end at, (M, 3), and when they begin."""

    poses: Floats
    begins_s: Floats


class Cut(NamedTuple):
    """A way to a pose of a route: how many legs it has, how many of them are new, and what."""

    legs: int
    new: int
    way: tuple[Leg, ...]


def move_of(problem: PlanningProblem, start: Floats, end: Floats) -> Move:
    """The straight move of a parcel between two poses."""
    body, ground = problem.task.shape.body, problem.ground
    way = end - start
    met = ground.tiles.swept(body, start[None], end[None], ground.clearance_m)
    own = np.hypot(way[:1], way[1:2]), np.abs(way[2:]) * body.bend_m
    lasts_s = float(ground.pace.times_s(*own, np.ones(1))[0])
    enters_s, leaves_s = (ground.pace.times_s(*own, each) for each in (met.enters, met.leaves))
    return Move(lasts_s, Met(met.first, met.tile, enters_s, leaves_s))


def legs_of(route: Route) -> int:
    """How many straight legs a route has, as `Path.legs_m`; resting on its way makes none more."""
    return _legs_of(route.poses, route.reach_m)


def _legs_of(poses: Floats, reach_m: float) -> int:
    path = Path(poses, reach_m)
    return len(path.legs_m) if path.pieces else 0


class Straightening:
    """One parcel's route among all others, which take their tiles as `taken` says.

    No new leg begins before the legs that it replaces, nor ends after them, so that all other
    routes may stay as planned. Tiles that are `closed` are crossed only where they were.
    """

    def __init__(self, problem: PlanningProblem, route: Route, taken: Taken, closed: Bools) -> None:
        self._problem = problem
        self._route = route
        self._taken = taken
        self._closed = closed.copy()
        self._closed[route.visits.tile] = False

    def route(self) -> Route:
        """The route with as few legs as there is a way of."""
        least = [Cut(0, 0, ())]
        for last in range(1, len(self._route.poses)):
            ways = [
                Cut(before.legs + self._count(first, leg), before.new + new, (*before.way, leg))
                for first, before in enumerate(least)
                for leg, new in self._legs(first, last)
            ]
            least.append(min(ways, key=lambda cut: (cut.legs, cut.new)))
        way = least[-1].way
        poses = np.concatenate([self._route.poses[:1], *(leg.poses for leg in way)])
        return self._problem.along(poses, np.concatenate([leg.begins_s for leg in way]))

    def _count(self, first: int, leg: Leg) -> int:
        """How many legs that leg from a pose of the route is, which may turn by a half."""
        start = self._route.poses[first : first + 1]
        return _legs_of(np.concatenate((start, leg.poses)), self._route.reach_m)

    def _legs(self, first: int, last: int) -> list[tuple[Leg, bool]]:
        """The leg from one pose of the route to another, if there is one, and whether it is new."""
        route = self._route
        moves = route.poses[first + 1 : last + 1], route.begins_s[first:last]
        if len(Path(route.poses[first : last + 1], route.reach_m).pieces) == 1:
            return [(Leg(*moves), False)]
        begin_s = self._begin_s(first, last)
        if begin_s is None:
            return []
        return [(Leg(route.poses[last : last + 1], np.array([begin_s])), True)]

    def _begin_s(self, first: int, last: int) -> float | None:
        """When the straight way between two poses of the route may begin; None: not at all."""
        problem, route = self._problem, self._route
        start, end = route.poses[first], route.poses[last]
        move = move_of(problem, start, end)
        if self._closed[move.met.tile].any():
            return None
        from_s, to_s = float(route.begins_s[first]), float(route.arrives_s[last - 1])
        latest_s = to_s - move.lasts_s
        for earliest_s in (from_s, latest_s):
            begin_s = first_departure(self._taken, move.met, 0, 0, (earliest_s, latest_s))
            stays = (start, from_s, begin_s), (end, begin_s + move.lasts_s, to_s)
            if begin_s < np.inf and all(self._may_stand(*stay) for stay in stays):
                return begin_s if self._is_safe(start, end) else None
        return None

    def _may_stand(self, pose: Floats, from_s: float, to_s: float) -> bool:
        """Whether the tiles under the parcel are free from an instant to another."""
        problem = self._problem
        under: Ints = problem.ground.stand(problem.task.shape, pose)
        return bool(free_until(self._taken, 0, under, from_s) >= to_s)

    def _is_safe(self, start: Floats, end: Floats) -> bool:
        """Whether it stays on the table and does not tip on the straight way between poses."""
        standing = self._problem.standing
        over_m = standing.overhangs_m(start[None], end[None])[0]
        return bool(over_m <= _HAIR_M) and standing.stands(start, end)


#: Routes are this much farther apart than they have to be: a search adds such hairs to its own [s].
_HAIR_S = 1e-6

#: A parcel and a path coordinate of its route [m].
Place = tuple[str, float]


class After(NamedTuple):
    """Moves that begin so long after others at the least, by numbers over all routes; all (A,)."""

    move: Ints
    other: Ints
    apart_s: Floats


def retimed(
    reservations: Reservations,
    progress_m: Mapping[str, float],
    now_s: float,
    pace: Pace,
    gap_s: float,
) -> dict[str, Route]:
    """The rest of the routes of parcels at these path coordinates, each as soon as it can be.

    The order over every tile stays, and so do poses and path coordinates. Tiles that are left are
    left out. Parcels without progress are no longer on the table. The soonest times are the least
    that no order contradicts: each route is free at its own among all others at theirs.
    """
    routes = {name: route for name, route in reservations.routes.items() if name in progress_m}
    moves = _numbers(routes)
    begins_s = np.empty(sum(map(len, moves.values())))
    for name, route in routes.items():
        begins_s[moves[name]] = _begins_s(route, progress_m[name], now_s, pace)
    places = _places(reservations.waits, moves, progress_m)
    settle(begins_s, _after(routes, moves, places, pace, gap_s))
    return {
        name: _with_times(route, begins_s[moves[name]], progress_m[name], pace)
        for name, route in routes.items()
    }


def _numbers(routes: Mapping[str, Route]) -> dict[str, Ints]:
    """The numbers of each route's moves over all of them."""
    ends = np.cumsum([0, *(len(route.begins_s) for route in routes.values())]).tolist()
    return {name: np.arange(*ends) for name, ends in zip(routes, pairwise(ends), strict=True)}


@compiled
def settle(begins_s: Floats, after: After) -> None:
    """Delay the begins of moves as much as the moves before them ask for."""
    # Each pass settles the next move in the order at least, and the order has no circle.
    for _ in range(begins_s.size + 1):
        changed = False
        for row in range(after.move.size):
            least_s = begins_s[after.other[row]] + after.apart_s[row]
            if begins_s[after.move[row]] < least_s:
                begins_s[after.move[row]], changed = least_s, True
        if not changed:
            break


def _places(
    waits: Mapping[str, Sequence[Wait]], moves: Mapping[str, Ints], progress_m: Mapping[str, float]
) -> tuple[list[Place], list[Place]]:
    """Places where parcels wait for others, and places of the others that end these waits.

    A tile is really left up to `REST_M` farther on than those who wait for it are to see it left. A
    parcel that stays has no move to wait with, though it may have been set down where another
    stands.
    """
    enters: list[Place] = []
    leaves: list[Place] = []
    for name, own in moves.items():
        for before_m, other, leaves_m in waits[name] if len(own) else ():
            if other in moves and progress_m[other] < leaves_m < np.inf:
                enters.append((name, before_m))
                leaves.append((other, leaves_m + REST_M))
    return enters, leaves


def _after(
    routes: Mapping[str, Route],
    moves: Mapping[str, Ints],
    places: tuple[Sequence[Place], Sequence[Place]],
    pace: Pace,
    gap_s: float,
) -> After:
    """Each move after the one before it on its route, and after those that are waited for."""
    enter, after_enter_s = _all_within(routes, moves, places[0], pace, "right")
    leave, after_leave_s = _all_within(routes, moves, places[1], pace, "left")
    apart_s = after_leave_s - after_enter_s + gap_s + _HAIR_S
    lasts_s = [(route.arrives_s - route.begins_s)[:-1] for route in routes.values()]
    return After(
        np.concatenate([*(own[1:] for own in moves.values()), enter]),
        np.concatenate([*(own[:-1] for own in moves.values()), leave]),
        np.concatenate([*lasts_s, apart_s]),
    )


def _all_within(
    routes: Mapping[str, Route],
    moves: Mapping[str, Ints],
    places: Sequence[Place],
    pace: Pace,
    side: Literal["left", "right"],
) -> tuple[Ints, Floats]:
    """The result of `_within` for several parcels, by numbers over all routes."""
    rows: dict[str, list[int]] = defaultdict(list)
    for row, (name, _) in enumerate(places):
        rows[name].append(row)
    at_m = np.array([at_m for _, at_m in places])
    numbers, after_s = np.zeros(len(places), dtype=np.int64), np.zeros(len(places))
    for name, own in rows.items():
        move, after_s[own] = _within(routes[name], at_m[own], pace, side)
        numbers[own] = moves[name][move]
    return numbers, after_s


def _begins_s(route: Route, progress_m: float, now_s: float, pace: Pace) -> Floats:
    """When each move begins at the soonest.

    The one under way, and those that are done, began as if the parcel had kept its pace.
    """
    begins_s = np.full(len(route.begins_s), now_s)
    if len(begins_s):
        moves, since_s = _within(route, np.array([progress_m]), pace, "right")
        move = moves[0]
        begins_s[move] -= since_s[0]
        begins_s[:move] = route.begins_s[:move] + begins_s[move] - route.begins_s[move]
    return begins_s


def _within(
    route: Route, at_m: Floats, pace: Pace, side: Literal["left", "right"]
) -> tuple[Ints, Floats]:
    """The moves that these path coordinates are on, and how long after their begin [s].

    `side` is of the two moves at a pose the one that ends there, or the one that begins.
    """
    if not len(route.begins_s):
        return np.zeros(len(at_m), dtype=np.int64), np.zeros(len(at_m))
    move = np.searchsorted(route.along_m[1:-1], at_m, side=side)
    ways, shares = ways_at(route.poses, route.along_m, move, at_m)
    return move, pace.times_s(ways[0], ways[1] * route.reach_m, shares)


@compiled
def ways_at(poses: Floats, along_m: Floats, move: Ints, at_m: Floats) -> tuple[Floats, Floats]:
    """Lengths and turns of these moves [m, rad], (2, N), and shares of them at path coordinates."""
    ways, shares = np.empty((2, move.size)), np.empty(move.size)
    for index in range(move.size):
        here = move[index]
        way_x_m, way_y_m = poses[here + 1, 0] - poses[here, 0], poses[here + 1, 1] - poses[here, 1]
        ways[0, index] = np.sqrt(way_x_m**2 + way_y_m**2)
        ways[1, index] = abs(poses[here + 1, 2] - poses[here, 2])
        span_m = max(along_m[here + 1] - along_m[here], 1e-12)
        shares[index] = min(max((at_m[index] - along_m[here]) / span_m, 0.0), 1.0)
    return ways, shares


def _with_times(route: Route, begins_s: Floats, progress_m: float, pace: Pace) -> Route:
    """The route with moves at these times, and without the tiles that are left."""
    kept = route.visits.leaves_m > progress_m
    visits = route.visits
    enters_m, leaves_m = visits.enters_m[kept], visits.leaves_m[kept]
    enters_s, leaves_s = visits.enters_s[kept], visits.leaves_s[kept]
    arrives_s = begins_s + (route.arrives_s - route.begins_s)
    if len(begins_s):
        move, after_s = _within(route, np.where(np.isinf(leaves_m), 0.0, leaves_m), pace, "left")
        stays_s = leaves_s + arrives_s[-1] - route.arrives_s[-1]
        leaves_s = np.where(np.isinf(leaves_m), stays_s, begins_s[move] + after_s)
        move, after_s = _within(route, enters_m, pace, "right")
        enters_s = np.where(np.isinf(enters_s), -np.inf, begins_s[move] + after_s)
    visits = Visits(visits.tile[kept], enters_m, leaves_m, enters_s, leaves_s)
    return replace(route, begins_s=begins_s, arrives_s=arrives_s, visits=visits)
