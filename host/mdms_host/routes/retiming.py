"""Routes that are under way, with the times that follow from where all really are."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from mdms_host.routes.pace import Pace
from mdms_host.routes.reservations import REST_M, Reservations, Wait
from mdms_host.routes.route import Route, Visits
from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled

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
