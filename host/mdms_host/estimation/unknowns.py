"""Things on the table that are no given parcels, by the sensors that they cover.

The outline of such a thing contains every convex parcel over its sensors and beside others. A
convex parcel over the sensors C reaches a point q only if the hull of C and q holds no sensor that
is free. So each free sensor f keeps the parcel out of a shadow: the cone with its apex at f that
the hull of C throws if light comes from there. The rest is the union of all convex parcels that the
sensors allow.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from math import inf

import numpy as np

from mdms_host.estimation.belief import Belief, BeliefChange, BeliefEvent, BeliefKind
from mdms_host.estimation.footprint import Polygon
from mdms_host.estimation.presence import Surroundings
from mdms_host.estimation.size import Size, rectangles_of, size_of
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.outline import convex_hull, polygon_outline

_ANGLES = np.arange(256) * (2 * np.pi / 256)
_DIRECTIONS = np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES)))
#: For the gap between two directions, and for inexact places of sensors [m].
_SPARE_M = 0.005
#: A free sensor so far inside the hull of the covered ones shows that no convex parcel lies there.
_INSIDE_M = 0.002


def containing_outline_m(covered_m: Floats, free_m: Floats, most_m: float) -> Floats:
    """Corners (K, 2) of a convex outline of a thing over the sensors (C, 2) but not (F, 2).

    It reaches no farther than `most_m` beyond the covered ones, where nothing shows how far.
    """
    hull_m = convex_hull(covered_m)
    centre_m = hull_m.mean(axis=0)
    reach_m = (_DIRECTIONS @ (hull_m - centre_m).T).max(axis=1) + most_m
    if len(hull_m) > 1 and len(free_m):
        reach_m = np.minimum(reach_m, _shadows_m(hull_m, free_m, centre_m))
    rim_m = centre_m + _DIRECTIONS * (reach_m + _SPARE_M)[:, None]
    return convex_hull(np.vstack((rim_m, hull_m)))


def is_convex(covered_m: Floats, free_m: Floats) -> bool:
    """Whether one convex parcel can cover the sensors (C, 2), but not (F, 2)."""
    hull_m = convex_hull(covered_m)
    if len(hull_m) < 3 or not len(free_m):
        return True
    edges = polygon_outline(hull_m).edges
    over_m = free_m @ edges[:, :2].T - edges[:, 2]
    return not (over_m.max(axis=1) < -_INSIDE_M).any()


def _shadows_m(hull_m: Floats, free_m: Floats, centre_m: Floats) -> Floats:
    """How far from the centre the nearest shadow is in each direction [m]; inf without one."""
    from_hull_m = free_m[:, None, :] - hull_m
    outward_m = free_m - centre_m
    # How far the shadow opens to either side of the line from the centre: its two tangents.
    turned = np.arctan2(
        _cross(outward_m[:, None, :], from_hull_m),
        (outward_m[:, None, :] * from_hull_m).sum(axis=2),
    )
    rows = np.arange(len(free_m))
    right_m = from_hull_m[rows, turned.argmin(axis=1)]
    left_m = from_hull_m[rows, turned.argmax(axis=1)]
    # In it is where cross(right, q - f) >= 0 and cross(q - f, left) >= 0, q = centre + r direction.
    along = _DIRECTIONS[:, None, :]
    opens = _cross(right_m, along), _cross(along, left_m)
    needs = _cross(right_m, outward_m), _cross(outward_m, left_m)
    low_m, high_m = np.zeros(opens[0].shape), np.full(opens[0].shape, np.inf)
    for rate, need in zip(opens, needs, strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            met_m = need / rate
        low_m = np.where(rate > 0, np.maximum(low_m, met_m), low_m)
        high_m = np.where(rate < 0, np.minimum(high_m, met_m), high_m)
        high_m = np.where((rate == 0) & (need > 0), -np.inf, high_m)
    nearest_m: Floats = np.where(low_m <= high_m, low_m, np.inf).min(axis=1)
    return nearest_m


def _cross(one: Floats, other: Floats) -> Floats:
    product: Floats = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return product


#: Something is there once so many sensors, of so many cells, have been covered for so long [s].
#: A thing on wheels covers more than one cell; all sensors of a broken cell may be wrong.
_SENSORS = 3
_CELLS = 2
_STEADY_S = 0.15
#: It is reported once no parcel that is looked for may turn out to be it, or after so long [s].
_REPORTED_S = 1.0
#: It is gone once none of its sensors has been covered for so long [s].
_GONE_S = 0.1
#: Where no sensor shows how far it reaches, it does so many links of sensors at most.
_MOST_LINKS = 1.5
#: So many rectangles are tried for something whose size is to be learned.
_RECTANGLES = 4000


@dataclass(slots=True)
class Unknown:
    """Something unknown: the sensors under it, and an outline about its pose that contains it."""

    name: str
    since_s: float
    seen_s: float
    sensors: Ints
    outline: Polygon
    pose: Floats
    kind: BeliefKind
    reported: BeliefKind | None = None
    corrected: bool = True

    @property
    def corners_m(self) -> Floats:
        """Corners of the outline on the table [m; table frame], shape (K, 2)."""
        return self.outline.outline_m(self.pose)

    def change(self, event: BeliefEvent, other: str = "") -> BeliefChange:
        """An event of it."""
        along_m, across_m = np.ptp(self.outline.corners_m, axis=0).tolist()
        return BeliefChange(self.name, event, self.pose, (along_m, across_m), other)


class Unknowns:
    """All that is unknown, by names that no two ever share: `unknown-1` and so on.

    `link_m` is how far neighbouring sensors are from each other.
    """

    def __init__(self, layout: Layout, surroundings: Surroundings, link_m: float) -> None:
        self._surroundings = surroundings
        self._sensors_m = layout.sensors_m
        self._of_cell = layout.sensor_cells
        self._most_m = _MOST_LINKS * link_m
        self._since_s: Floats = np.full(len(self._sensors_m), inf)
        self._all: dict[str, Unknown] = {}
        self._count = 0
        #: Whether any sensor has been covered since a known time.
        self._ages = False
        self._changes: list[BeliefChange] = []

    @property
    def all(self) -> Mapping[str, Unknown]:
        """Everything unknown that is there now."""
        return self._all

    @property
    def idle(self) -> bool:
        """Whether nothing is there, nor seemed to be at the last step."""
        return not (self._all or self._ages)

    @property
    def sensors(self) -> Bools:
        """Which sensors are under any of it, shape (S,)."""
        under: Bools = np.zeros(len(self._sensors_m), dtype=bool)
        for one in self._all.values():
            under[one.sensors] = True
        return under

    def beliefs(self) -> Iterator[Belief]:
        """The beliefs of unknown things: each rests, and is somewhere in its outline."""
        for one in self._all.values():
            yield Belief(
                one.name,
                one.outline,
                one.pose,
                np.zeros(3),
                np.zeros((3, 3)),
                corrected=one.corrected,
                kind=one.kind,
            )
            one.corrected = False

    def take_changes(self) -> list[BeliefChange]:
        """Changes of unknown things since the last call."""
        changes, self._changes = self._changes, []
        return changes

    def step(
        self,
        now_s: float,
        groups: Collection[Ints],
        free: Bools,
        *,
        mute: Bools,
        heaps: Collection[bytes],
        settled: bool,
    ) -> None:
        """Take in the groups of covered sensors that nothing explains, and which sensors are free.

        Things over `mute` sensors lie there still: the cells of these say nothing. `heaps` are
        groups that more than one parcel must cover, as bytes. `settled` is whether the parcels that
        are looked for have been tried on all groups.
        """
        left = self._matched(now_s, groups, free, mute)
        self._age(now_s, left)
        for group in left:
            if self._is_something(now_s, group):
                self._count += 1
                name = f"unknown-{self._count}"
                self._all[name] = self._drawn(name, now_s, now_s, group, free)
        for name, one in list(self._all.items()):
            if one.seen_s < now_s - _GONE_S:
                self._drop(name, BeliefEvent.CLEARED)
                continue
            if one.sensors.tobytes() in heaps:
                one.kind = BeliefKind.HEAP
            if settled or now_s >= one.since_s + _REPORTED_S:
                self._report(one)

    def size(self, name: str, free: Bools) -> Size | None:
        """How large something is if it is a rectangle; None if it cannot be. Raises KeyError."""
        one = self._all[name]
        near = self._surroundings.of(one.pose[:2], one.outline.reach_m)
        return size_of(self._sensors_m[one.sensors], near.sensors_m[free[near.sensors]])

    def rectangles(self, group: Ints, free: Bools, yaw_rad: float) -> tuple[Floats, Floats]:
        """Poses (N, 3) and sides (N, 2) of rectangles that cover a group, about a yaw."""
        return rectangles_of(*self._around(group, free), yaw_rad, _RECTANGLES)

    def expect(self, sensors: Ints) -> None:
        """Something has been over these sensors for long: once nothing explains it, it is unknown.

        It need not be steady first.
        """
        self._since_s[sensors] = -inf
        self._ages = True

    def explain(self, parcel: str, inside: Bools) -> None:
        """A parcel has been found over the sensors `inside` (S,): what covered them is that."""
        for name, one in list(self._all.items()):
            if 2 * inside[one.sensors].sum() > len(one.sensors):
                self._drop(name, BeliefEvent.EXPLAINED, parcel)

    def _matched(
        self, now_s: float, groups: Collection[Ints], free: Bools, mute: Bools
    ) -> list[Ints]:
        """Take groups for known things, as far as they share sensors; the groups left over."""
        left = list(groups)
        for name, one in self._all.items():
            group = one.sensors[mute[one.sensors]]
            shared = [len(np.intersect1d(one.sensors, each)) for each in left]
            if most := max(shared, default=0):
                group = np.union1d(left.pop(shared.index(most)), group)
            if not len(group):
                continue
            if np.array_equal(group, one.sensors):
                one.seen_s = now_s
            else:
                drawn = self._drawn(name, one.since_s, now_s, group, free)
                drawn.reported = one.reported
                self._all[name] = drawn
        return left

    def _age(self, now_s: float, groups: Collection[Ints]) -> None:
        """Note since when sensors have been covered by groups that nothing explains yet."""
        since_s = np.full(len(self._since_s), inf)
        for group in groups:
            since_s[group] = np.minimum(self._since_s[group], now_s)
        self._since_s, self._ages = since_s, bool(groups)

    def _is_something(self, now_s: float, group: Ints) -> bool:
        steady = group[self._since_s[group] <= now_s - _STEADY_S]
        return len(steady) >= _SENSORS and len(np.unique(self._of_cell[steady])) >= _CELLS

    def _drawn(self, name: str, since_s: float, now_s: float, group: Ints, free: Bools) -> Unknown:
        """The outline around a group of sensors; a heap reaches as far as any part of it may."""
        covered_m, free_m = self._around(group, free)
        convex = is_convex(covered_m, free_m)
        limits_m = free_m if convex else free_m[:0]
        corners_m = containing_outline_m(covered_m, limits_m, self._most_m)
        centre_m = (corners_m.min(axis=0) + corners_m.max(axis=0)) / 2
        outline = Polygon(tuple((x, y) for x, y in (corners_m - centre_m).tolist()))
        kind = BeliefKind.UNKNOWN if convex else BeliefKind.HEAP
        pose = np.array([*centre_m.tolist(), 0.0])
        return Unknown(name, since_s, now_s, group, outline, pose, kind)

    def _around(self, group: Ints, free: Bools) -> tuple[Floats, Floats]:
        """The sensors of a group (C, 2), and free ones (F, 2) that may bound it [m]."""
        covered_m = self._sensors_m[group]
        middle_m = (covered_m.min(axis=0) + covered_m.max(axis=0)) / 2
        reach_m = float(np.hypot(*(covered_m - middle_m).T).max()) + self._most_m
        near = self._surroundings.of(middle_m, reach_m)
        free_m = near.sensors_m[free[near.sensors]]
        return covered_m, free_m

    def _report(self, one: Unknown) -> None:
        if one.reported is not one.kind:
            one.reported = one.kind
            event = BeliefEvent.APPEARED if one.kind is BeliefKind.UNKNOWN else BeliefEvent.HEAPED
            self._changes.append(one.change(event))

    def _drop(self, name: str, event: BeliefEvent, other: str = "") -> None:
        one = self._all.pop(name)
        if one.reported is not None:
            self._changes.append(one.change(event, other))
