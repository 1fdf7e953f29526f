"""Whether parcels that keep to a plan's times arrive, and touch nothing: by outlines of `shapely`.

It has no code in common with the planner: outlines are swept over short spans of time in continuous
space, and looked at closer where two spans come near.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import ceil, hypot

import numpy as np
from shapely.geometry import MultiPoint, Point, Polygon

from mdms_host.estimation.footprint import Disc, Rectangle
from mdms_host.routes.planner import RoutePlan
from mdms_host.routes.planning_problem import RouteTask
from mdms_host.routes.route import Route
from mdms_host.routes.support import Shape

#: Of moves from rest to rest, as plans of these benchmarks have them.
SPEED_M_S, ACCELERATION_M_S2 = 0.3, 0.6
#: Spans in which outlines are swept, and the finest ones [s].
SPAN_S, FINEST_S = 0.25, 0.002
#: How far over the edge is rounding [m], and at how many instants of a span it is looked at.
EDGE_M, EDGE_TIMES = 5e-6, 60


def corners_m(shape: Shape) -> np.ndarray:
    """Corners of the outline about its own centre, those of a polygon for a disc's."""
    footprint = shape.footprint
    if isinstance(footprint, Disc):
        circle = Point(0.0, 0.0).buffer(footprint.diameter_m / 2, quad_segs=16)
        return np.array(circle.exterior.coords)[:-1]
    assert isinstance(footprint, Rectangle)
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    return signs * np.array([footprint.length_m, footprint.width_m]) / 2


def shares_done(ways_m: np.ndarray, since_s: np.ndarray) -> np.ndarray:
    """How much of moves from rest to rest is done a while after their begin."""
    ramps_s = np.minimum(SPEED_M_S / ACCELERATION_M_S2, np.sqrt(ways_m / ACCELERATION_M_S2))
    tops_m_s = ramps_s * ACCELERATION_M_S2
    lasts_s = ways_m / tops_m_s + ramps_s
    left_s = lasts_s - since_s
    done_m = np.where(
        since_s < ramps_s,
        ACCELERATION_M_S2 * since_s**2 / 2,
        np.where(
            left_s < ramps_s,
            ways_m - ACCELERATION_M_S2 * left_s**2 / 2,
            (since_s - ramps_s / 2) * tops_m_s,
        ),
    )
    return np.where(since_s <= 0.0, 0.0, np.where(left_s <= 0.0, 1.0, done_m / ways_m))


@dataclass
class Swept:
    """Outlines over spans of time; spans are kept, since every pair asks for the same ones."""

    task: RouteTask
    route: Route
    spans: dict[tuple[float, float], Polygon] = field(default_factory=dict)

    @cached_property
    def own_m(self) -> np.ndarray:
        """Corners about its own centre."""
        return corners_m(self.task.shape)

    @cached_property
    def reach_m(self) -> float:
        """From the centre to the farthest corner."""
        return float(self.task.shape.footprint.reach_m)

    @cached_property
    def rest_s(self) -> np.ndarray:
        """When moves begin and end."""
        return np.unique(np.concatenate((self.route.begins_s, self.route.arrives_s)))

    def poses(self, times_s: np.ndarray) -> np.ndarray:
        """Where the parcel is that keeps to its times, shape (T, 3)."""
        route, poses = self.route, self.route.poses
        if len(poses) == 1:
            return np.repeat(poses, len(times_s), axis=0)
        turn_m = 0.0 if isinstance(self.task.shape.footprint, Disc) else self.reach_m
        moves = np.clip(np.searchsorted(route.begins_s, times_s) - 1, 0, None)
        ways = np.diff(poses, axis=0)[moves]
        ways_m = np.sqrt(ways[:, 0] ** 2 + ways[:, 1] ** 2 + (ways[:, 2] * turn_m) ** 2)
        shares = shares_done(ways_m, times_s - route.begins_s[moves])
        return poses[moves] + ways * shares[:, None]

    def corners_m(self, poses: np.ndarray) -> np.ndarray:
        """The corners at poses, shape (P, C, 2)."""
        cosine, sine = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
        x_m, y_m = self.own_m.T
        turned_m = np.stack((cosine * x_m - sine * y_m, sine * x_m + cosine * y_m), axis=2)
        return turned_m + poses[:, None, :2]

    def key_poses(self, from_s: float, to_s: float) -> np.ndarray:
        """Poses at both ends of a span and where it rests between: the ways between are straight.

        A single one where it is at rest all the while.
        """
        inner_s = self.rest_s[(self.rest_s > from_s) & (self.rest_s < to_s)]
        poses = self.poses(np.array([from_s, *inner_s, to_s]))
        return poses[:1] if (poses == poses[0]).all() else poses

    def over(self, from_s: float, to_s: float) -> Polygon:
        """The area that the outline meets within a span, and a little more: the bulge of a turn."""
        if (from_s, to_s) not in self.spans:
            parts_m = self.corners_m(self.key_poses(from_s, to_s))
            hull = Polygon(parts_m[0])
            if len(parts_m) > 1:
                turn_rad = SPEED_M_S * (to_s - from_s) / self.reach_m
                bulge_m = self.reach_m * (1 - np.cos(turn_rad / 2))
                hull = MultiPoint(parts_m.reshape(-1, 2)).convex_hull.buffer(bulge_m)
            self.spans[from_s, to_s] = hull
        return self.spans[from_s, to_s]

    def boxes_m(self, ends_s: np.ndarray) -> np.ndarray:
        """Around all that the outline meets in each span: x and y from and to, (spans, 4)."""
        low_m, high_m = np.full((2, len(ends_s) - 1, 2), np.inf)
        times_s = np.concatenate((ends_s[:-1], ends_s[1:], self.rest_s))
        places_m = self.poses(times_s)[:, :2]
        spans = np.arange(len(ends_s) - 1)
        rests = np.clip(np.searchsorted(ends_s, self.rest_s, side="right") - 1, 0, len(spans) - 1)
        own = np.concatenate((spans, spans, rests))
        np.minimum.at(low_m, own, places_m)
        np.minimum.at(high_m, own, -places_m)
        return np.hstack((low_m - self.reach_m, self.reach_m - high_m))


def touch(one: Swept, other: Swept, from_s: float, to_s: float) -> bool:
    """Whether two outlines may meet within a span."""
    if not one.over(from_s, to_s).intersects(other.over(from_s, to_s)):
        return False
    middle_s = (from_s + to_s) / 2
    if to_s - from_s < FINEST_S:
        return True
    return touch(one, other, from_s, middle_s) or touch(one, other, middle_s, to_s)


def hangs_over(half_m: np.ndarray, one: Swept, from_s: float, to_s: float) -> bool:
    """Whether an outline is beyond the edge within a span."""
    poses = one.key_poses(from_s, to_s)
    if len(poses) > 1:
        poses = one.poses(np.linspace(from_s, to_s, EDGE_TIMES))
    return bool((np.abs(one.corners_m(poses)) > half_m).any())


def faults(size_m: tuple[float, float], tasks: Sequence[RouteTask], plan: RoutePlan) -> list[str]:
    """The faults of a plan for a table of this size: parcels that touch or do not arrive."""
    found = [str(blocked) for blocked in plan.blocked.values()]
    swept = [Swept(task, plan.routes[task.parcel]) for task in tasks]
    half_m = np.array(size_m) / 2 + EDGE_M
    end_s = max((route.end_s for route in plan.routes.values()), default=0.0)
    ends_s = np.arange(ceil(max(end_s, 0.0) / SPAN_S) + 2) * SPAN_S
    boxes_m = [each.boxes_m(ends_s) for each in swept]
    for index, one in enumerate(swept):
        away = one.route.poses[-1] - one.task.goal
        turned = 0.0 if one.task.shape.round else (away[2] + np.pi) % (2 * np.pi) - np.pi
        if hypot(*away[:2]) > 1e-9 or abs(turned) > 1e-9:
            found.append(f"{one.task.parcel} ends elsewhere")
        own_m = boxes_m[index]
        for span in np.flatnonzero(
            (own_m[:, :2] < -half_m).any(1) | (own_m[:, 2:] > half_m).any(1)
        ):
            if hangs_over(half_m, one, ends_s[span], ends_s[span + 1]):
                found.append(f"{one.task.parcel} hangs over the edge at {ends_s[span]} s")
        for other, its_m in zip(swept[:index], boxes_m, strict=False):
            near = (own_m[:, :2] <= its_m[:, 2:]).all(1) & (its_m[:, :2] <= own_m[:, 2:]).all(1)
            for span in np.flatnonzero(near):
                if touch(one, other, ends_s[span], ends_s[span + 1]):
                    found.append(
                        f"{one.task.parcel} touches {other.task.parcel} at {ends_s[span]} s"
                    )
    return found
