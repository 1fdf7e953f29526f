"""Routes that are under way, with the times that follow from where all really are."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from mdms_host.routes.pace import Pace
from mdms_host.routes.reservations import REST_M, Reservations
from mdms_host.routes.route import Route, Visits
from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled

#: Routes are this much farther apart than they have to be: a search adds such hairs to its own [s].
_HAIR_S = 1e-6


def retimed(
    reservations: Reservations,
    progress_m: Mapping[str, float],
    now_s: float,
    pace: Pace,
    gap_s: float,
) -> dict[str, Route]:
    """What is left of the routes of parcels at these path coordinates, each as soon as it can be.

    The order over every tile stays, and so do poses and path coordinates; tiles that are left are
    left out. Parcels without progress are no longer on the table. The soonest times are the least
    that no order contradicts: each route is free at its own among all others at theirs.
    """
    routes = {name: route for name, route in reservations.routes.items() if name in progress_m}
    begins_s = {
        name: _begins_s(route, progress_m[name], now_s, pace) for name, route in routes.items()
    }
    after = _after(reservations, routes, progress_m, pace, gap_s)
    lasts_s = {name: route.arrives_s - route.begins_s for name, route in routes.items()}
    # Each pass settles the next move in the order at least, and the order has no circle.
    for _ in range(sum(map(len, begins_s.values())) + 1):
        changed = False
        for name, own_s in begins_s.items():
            for move in range(1, len(own_s)):
                least_s = own_s[move - 1] + lasts_s[name][move - 1]
                changed |= bool(own_s[move] < least_s)
                own_s[move] = max(own_s[move], least_s)
        for name, move, other, others, apart in after:
            least_s = begins_s[other][others] + apart
            changed |= bool(begins_s[name][move] < least_s)
            begins_s[name][move] = max(begins_s[name][move], least_s)
        if not changed:
            break
    return {
        name: _with_times(route, begins_s[name], lasts_s[name], progress_m[name], pace)
        for name, route in routes.items()
    }


def _after(
    reservations: Reservations,
    routes: Mapping[str, Route],
    progress_m: Mapping[str, float],
    pace: Pace,
    gap_s: float,
) -> list[tuple[str, int, str, int, float]]:
    """A parcel's move, and another's that it begins so long after at the least.

    A tile is really left up to `REST_M` farther on than those who wait for it are to see it left.
    Who stays has no move to wait with, though it may have been set down where another stands.
    """
    waits = [
        (name, wait)
        for name, route in routes.items()
        for wait in (reservations.waits[name] if len(route.begins_s) else ())
        if wait.other in routes and progress_m[wait.other] < wait.leaves_m < np.inf
    ]
    enters, after_enters_s = _all_within(
        routes, [(name, wait.before_m) for name, wait in waits], pace, "right"
    )
    leaves, after_leaves_s = _all_within(
        routes, [(wait.other, wait.leaves_m + REST_M) for _, wait in waits], pace, "left"
    )
    apart_s = (after_leaves_s - after_enters_s + gap_s + _HAIR_S).tolist()
    rows = zip(waits, enters.tolist(), leaves.tolist(), apart_s, strict=True)
    return [(name, move, wait.other, others, apart) for (name, wait), move, others, apart in rows]


def _all_within(
    routes: Mapping[str, Route],
    places: Sequence[tuple[str, float]],
    pace: Pace,
    side: Literal["left", "right"],
) -> tuple[Ints, Floats]:
    """What `_within` gives for path coordinates of several parcels, in their sequence."""
    rows: dict[str, list[int]] = defaultdict(list)
    for row, (name, _) in enumerate(places):
        rows[name].append(row)
    at_m = np.array([at_m for _, at_m in places])
    moves, after_s = np.zeros(len(places), dtype=np.int64), np.zeros(len(places))
    for name, own in rows.items():
        moves[own], after_s[own] = _within(routes[name], at_m[own], pace, side)
    return moves, after_s


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


def _with_times(
    route: Route, begins_s: Floats, lasts_s: Floats, progress_m: float, pace: Pace
) -> Route:
    """The route with moves at these times, and without the tiles that are left."""
    kept = route.visits.leaves_m > progress_m
    visits = route.visits
    enters_m, leaves_m = visits.enters_m[kept], visits.leaves_m[kept]
    enters_s, leaves_s = visits.enters_s[kept], visits.leaves_s[kept]
    arrives_s = begins_s + lasts_s
    if len(begins_s):
        move, after_s = _within(route, np.where(np.isinf(leaves_m), 0.0, leaves_m), pace, "left")
        stays_s = leaves_s + arrives_s[-1] - route.arrives_s[-1]
        leaves_s = np.where(np.isinf(leaves_m), stays_s, begins_s[move] + after_s)
        move, after_s = _within(route, enters_m, pace, "right")
        enters_s = np.where(np.isinf(enters_s), -np.inf, begins_s[move] + after_s)
    visits = Visits(visits.tile[kept], enters_m, leaves_m, enters_s, leaves_s)
    return replace(route, begins_s=begins_s, arrives_s=arrives_s, visits=visits)
