"""Routes of fewer legs: corners are left out that nothing asks for any more.

A search goes along its lattice and comes to rest where others pass. Once all have their routes,
most of its corners can be cut: the parcel goes straight while the tiles of that way are free.
"""

from typing import NamedTuple

import numpy as np

from mdms_host.motion.trajectory.path import Path
from mdms_host.routes.errand import Errand
from mdms_host.routes.intervals.safe_intervals import Taken, first_departure, free_until
from mdms_host.routes.route import Route
from mdms_host.routes.space.moves import Met
from mdms_model.arrays import Bools, Floats, Ints

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


def move_of(errand: Errand, start: Floats, end: Floats) -> Move:
    """The straight move of a parcel between two poses."""
    body, ground = errand.task.shape.body, errand.ground
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

    def __init__(self, errand: Errand, route: Route, taken: Taken, closed: Bools) -> None:
        self._errand = errand
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
        return self._errand.along(poses, np.concatenate([leg.begins_s for leg in way]))

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
        errand, route = self._errand, self._route
        start, end = route.poses[first], route.poses[last]
        move = move_of(errand, start, end)
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
        errand = self._errand
        under: Ints = errand.ground.stand(errand.task.shape, pose)
        return bool(free_until(self._taken, 0, under, from_s) >= to_s)

    def _is_safe(self, start: Floats, end: Floats) -> bool:
        """Whether it stays on the table and does not tip on the straight way between poses."""
        standing = self._errand.standing
        over_m = standing.overhangs_m(start[None], end[None])[0]
        return bool(over_m <= _HAIR_M) and standing.stands(start, end)
