"""The order of parcels on each tile, independent of the clock, and how far each may go now."""

from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import NamedTuple

import numpy as np

from mdms_host.routes.route import Route
from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled

#: A parcel that is this near to a pose of its route may have come to rest there [m].
REST_M = 0.005


class Visit(NamedTuple):
    """A parcel on a tile, from one path coordinate of its route to another [m]; inf: it stays."""

    parcel: str
    enters_m: float
    leaves_m: float
    enters_s: float
    leaves_s: float


class Wait(NamedTuple):
    """A parcel stays before `before_m` of its route until another has passed `leaves_m` of its."""

    before_m: float
    other: str
    leaves_m: float


@dataclass(frozen=True)
class Reservations:
    """The visits of all routes, by tile, in the order in which they were planned.

    The order is acyclic: of two visits of a tile the former ends before the latter begins, by the
    plan's times, and along each route times rise too. So among the moves that are not yet made the
    one planned first never waits for another of them, whichever parcel is late.

    No parcel enters a tile before those ahead have left it: that is its movement authority. A
    follower is expected to come to rest before the path coordinate that it is given, at poses of
    its route within `REST_M`. It rests before that by no more than the way that it makes from rest
    in the plan's `gap_s`.
    """

    routes: Mapping[str, Route]

    @cached_property
    def order(self) -> dict[int, tuple[Visit, ...]]:
        """The visits of each tile that any parcel is on, first ones first."""
        order: dict[int, list[Visit]] = defaultdict(list)
        for name, route in self.routes.items():
            columns = (column.tolist() for column in route.visits[1:])
            rows = zip(*columns, strict=True)
            for tile, row in zip(route.visits.tile.tolist(), rows, strict=True):
                order[tile].append(Visit(name, *row))
        return {
            tile: tuple(sorted(visits, key=lambda visit: (visit.enters_s, visit.leaves_s)))
            for tile, visits in order.items()
        }

    @cached_property
    def waits(self) -> dict[str, tuple[Wait, ...]]:
        """The waits of each parcel, by path coordinate, without those that follow from another."""
        names = list(self.routes)
        waits: dict[str, list[Wait]] = {name: [] for name in names}
        if not names:
            return {}
        columns = zip(*(route.visits for route in self.routes.values()), strict=True)
        tile, enters_m, _, enters_s, leaves_s = map(np.concatenate, columns)
        leaves_m = np.concatenate([_left_m(route) for route in self.routes.values()])
        owner = np.repeat(
            np.arange(len(names)), [len(route.visits.tile) for route in self.routes.values()]
        )
        order = np.lexsort((leaves_s, enters_s, tile))
        visits = tile[order], owner[order], enters_m[order], leaves_m[order]
        rows = stairs(len(names), *visits)
        for parcel, other, before_m, left_m in rows.tolist():
            waits[names[int(parcel)]].append(Wait(before_m, names[int(other)], left_m))
        return {name: tuple(sorted(own)) for name, own in waits.items()}

    def limits_m(self, progress_m: Mapping[str, float]) -> dict[str, float]:
        """The path coordinate up to which each way is free [m]; the route's end for all of it.

        `progress_m` is the path coordinate at which each parcel is believed to be. A parcel that is
        left out is no longer on the table.
        """
        limits_m: dict[str, float] = {}
        for name in progress_m.keys() & self.routes.keys():
            limit_m = self.routes[name].length_m
            for before_m, other, leaves_m in self.waits[name]:
                if before_m >= limit_m:
                    break
                if progress_m.get(other, inf) < leaves_m:
                    limit_m = before_m
            limits_m[name] = limit_m
        return limits_m

    def held(self, progress_m: Mapping[str, float], still: Collection[str]) -> frozenset[str]:
        """The parcels that never come to the end of their routes while those of `still` stay.

        They wait for these, or for another parcel that does. Parcels of `still` are not among them.
        """
        come_m, before_m = dict(progress_m), None
        while come_m != before_m:
            before_m = dict(come_m)
            limits_m = self.limits_m(come_m)
            for name in limits_m.keys() - still:
                come_m[name] = max(come_m[name], limits_m[name])
        going = come_m.keys() & self.routes.keys() - set(still)
        return frozenset(name for name in going if come_m[name] < self.routes[name].length_m)


def _left_m(route: Route) -> Floats:
    """Where tiles are left, at the latest by `REST_M` before a pose where the parcel may rest."""
    leaves_m = route.visits.leaves_m
    rests_m = np.append(route.along_m, np.inf)[np.searchsorted(route.along_m, leaves_m - 1e-9)]
    left_m: Floats = np.where(
        np.isinf(leaves_m), np.inf, np.minimum(leaves_m, np.maximum(rests_m - REST_M, 0.0))
    )
    return left_m


@compiled
def stairs(owners: int, tile: Ints, owner: Ints, enters_m: Floats, leaves_m: Floats) -> Floats:
    """Waits of the owners of visits, these by tile and time; a wait that follows is left out.

    A row has the owner that waits, the owner before it, and where each enters and leaves [m].

    One wait follows from another of the same two that has an earlier `before` and a later `leaves`.
    """
    pairs = 0
    for later in range(1, len(tile)):
        first = later
        while first > 0 and tile[first - 1] == tile[later]:
            first -= 1
        pairs += later - first
    # No list: one that is returned by code from numba's cache crashes after a run of the row model.
    rows, count = np.empty((pairs, 4)), 0
    # The last row of each two owners; -1: there is none yet.
    last = np.full((owners, owners), -1)
    for later in np.argsort(enters_m):
        former, parcel = later - 1, owner[later]
        while former >= 0 and tile[former] == tile[later]:
            other, row = owner[former], last[parcel, owner[former]]
            if other != parcel and (row < 0 or rows[row, 3] < leaves_m[former]):
                if row < 0 or rows[row, 2] < enters_m[later]:
                    row = last[parcel, other] = count
                    count += 1
                rows[row, 0], rows[row, 1] = parcel, other
                rows[row, 2], rows[row, 3] = enters_m[later], leaves_m[former]
            former -= 1
    return rows[:count]
