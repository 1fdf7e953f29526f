"""The order of parcels on each tile: the promise of a plan, whatever the clock says."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mdms_host.routes.route import Route
from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled

#: A parcel that is this near to a pose of its route may have come to rest there [m].
REST_M = 0.005

#: The fields of `Wait`, with both parcels by number, the one that waits first.
Row = tuple[int, int, float, float]


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
        for parcel, other, before_m, left_m in rows:
            waits[names[parcel]].append(Wait(before_m, names[other], left_m))
        return {name: tuple(sorted(own)) for name, own in waits.items()}


def _left_m(route: Route) -> Floats:
    """Where tiles are left, at the latest by `REST_M` before a pose where the parcel may rest."""
    leaves_m = route.visits.leaves_m
    rests_m = np.append(route.along_m, np.inf)[np.searchsorted(route.along_m, leaves_m - 1e-9)]
    left_m: Floats = np.where(
        np.isinf(leaves_m), np.inf, np.minimum(leaves_m, np.maximum(rests_m - REST_M, 0.0))
    )
    return left_m


@compiled
def stairs(owners: int, tile: Ints, owner: Ints, enters_m: Floats, leaves_m: Floats) -> list[Row]:
    """Waits of the owners of visits, these by tile and time; a wait that follows is left out.

    One wait follows from another of the same two that has an earlier `before` and a later `leaves`.
    """
    rows: list[Row] = []
    # The last row of each two owners; -1: there is none yet.
    last = np.full((owners, owners), -1)
    for later in np.argsort(enters_m):
        former, parcel = later - 1, owner[later]
        while former >= 0 and tile[former] == tile[later]:
            other, row = owner[former], last[parcel, owner[former]]
            if other != parcel and (row < 0 or rows[row][3] < leaves_m[former]):
                if row < 0 or rows[row][2] < enters_m[later]:
                    row = last[parcel, other] = len(rows)
                    rows.append((parcel, other, 0.0, 0.0))
                rows[row] = parcel, other, enters_m[later], leaves_m[former]
            former -= 1
    return rows
