"""What is left of routes that parcels are on: the tiles that are still to come, and when.

Plans are kept to in their order and not by the clock, so that times have to be worked out anew
before others are planned around them: from where each parcel is, at the planned pace, waiting for
whom it has to wait for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf

import numpy as np

from mdms_host.routes.pace import Pace
from mdms_host.routes.reservations import Wait
from mdms_host.routes.route import Route, Visits
from mdms_model.arrays import Floats


class Remaining:
    """The rest of one route from `from_m` on, at the planned pace from `now_s`, as if from rest.

    `delays` are how long the parcel is held up before path coordinates, by what is in its way.
    """

    def __init__(self, route: Route, from_m: float, now_s: float, pace: Pace) -> None:
        self.route = route
        self.from_m = from_m
        self._now_s = now_s
        self._pace = pace
        self._delays: list[tuple[float, float]] = []

    def times_s(self, along_m: Floats) -> Floats:
        """When the parcel comes to path coordinates (N,) [s]; -inf where it has been."""
        times_s = np.full(along_m.shape, self._now_s)
        route = self.route
        poses = np.vstack((route.pose_at(self.from_m), route.poses))
        coordinates_m = np.concatenate(([self.from_m], route.along_m))
        keep = np.concatenate(([True], route.along_m > self.from_m))
        poses, coordinates_m = poses[keep], coordinates_m[keep]
        begin_s = self._now_s
        for number in range(len(poses) - 1):
            move = poses[number + 1] - poses[number]
            start_m, end_m = coordinates_m[number], coordinates_m[number + 1]
            shares = np.clip((along_m - start_m) / max(end_m - start_m, 1e-12), 0.0, 1.0)
            like = np.ones(len(shares) + 1)
            lasts_s = self._pace.times_s(
                like * np.hypot(move[0], move[1]),
                like * abs(move[2]) * route.reach_m,
                np.append(shares, 1.0),
            )
            times_s = np.where(along_m > start_m, begin_s + lasts_s[:-1], times_s)
            begin_s += float(lasts_s[-1])
        for before_m, delay_s in self._delays:
            times_s = np.where(along_m > before_m, times_s + delay_s, times_s)
        return np.where(along_m <= self.from_m, -inf, times_s)

    def passes_s(self, along_m: float, gone_s: float) -> float:
        """When it is past a path coordinate; what it leaves only by being gone, `gone_s` later."""
        if along_m <= self.from_m:
            return -inf
        end_m = self.route.length_m
        if along_m > end_m and not self.route.gone:
            return inf
        past_s = float(self.times_s(np.array([min(along_m, end_m)]))[0])
        # At its end already, it is about to be taken.
        past_s = max(past_s, self._now_s)
        return past_s + gone_s if along_m > end_m else past_s

    def hold_up(self, waits: Sequence[tuple[float, float]]) -> bool:
        """Be held up before path coordinates until times; True if that has changed anything."""
        before, self._delays = self._delays, []
        for before_m, until_s in sorted(waits):
            late_s = until_s - float(self.times_s(np.array([before_m]))[0])
            if before_m > self.from_m and late_s > 0.0:
                self._delays.append((before_m, late_s))
        return self._delays != before

    def as_route(self, gone_s: float) -> Route:
        """The route with the tiles that are left, and their times."""
        visits = self.route.visits
        left = visits.leaves_m > self.from_m
        tile, enters_m, leaves_m = visits.tile[left], visits.enters_m[left], visits.leaves_m[left]
        enters_s = self.times_s(enters_m)
        leaves_s = np.array([self.passes_s(each, gone_s) for each in leaves_m.tolist()])
        return replace(self.route, visits=Visits(tile, enters_m, leaves_m, enters_s, leaves_s))


def remaining(
    routes: Mapping[str, Route],
    progress_m: Mapping[str, float],
    waits: Mapping[str, Sequence[Wait]],
    pace: Pace,
    *,
    now_s: float,
    gone_s: float,
) -> dict[str, Route]:
    """What is left of these routes, of parcels that have come so far [m], in the order of `waits`.

    A parcel that leaves the table is gone `gone_s` after it has come to the end of its route.
    """
    rests = {
        name: Remaining(route, progress_m[name], now_s, pace) for name, route in routes.items()
    }
    # Each round settles those who wait for none but settled ones.
    for _ in rests:
        changed = False
        for name, rest in rests.items():
            until = [
                (wait.before_m, rests[wait.other].passes_s(wait.leaves_m, gone_s))
                for wait in waits.get(name, ())
                if wait.other in rests
            ]
            changed |= rest.hold_up(until)
        if not changed:
            break
    return {name: rest.as_route(gone_s) for name, rest in rests.items()}
