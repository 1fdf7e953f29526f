"""One route: straight moves between poses, when each tile is met, and how long moves take."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.compiled import compiled


class Pace(Protocol):
    """Times within straight moves from rest to rest, for planning: nobody has to keep to them."""

    def times_s(self, lengths_m: Floats, turns_m: Floats, shares: Floats) -> Floats:
        """When a share of a move is done, after its begin [s]; all arrays alike, as is the result.

        `turns_m` is the way of the farthest point of the outline as it turns about the centre, and
        `shares` are from 0 to 1. The time of share 1 is the duration; times rise with shares.
        """
        ...


@dataclass(frozen=True)
class TrapezoidPace:
    """A constant acceleration to a greatest speed, and the same back to rest.

    Both are of the centre and of the corners' turning together, as `motion.goal.Limits` has them.
    """

    speed_m_s: float = 0.3
    acceleration_m_s2: float = 0.6

    def __post_init__(self) -> None:
        if min(self.speed_m_s, self.acceleration_m_s2) <= 0.0:
            raise ValueError(
                f"speed and acceleration must be above 0, got {self.speed_m_s} m/s and "
                f"{self.acceleration_m_s2} m/s2"
            )

    def times_s(self, lengths_m: Floats, turns_m: Floats, shares: Floats) -> Floats:
        """When a share of a move is done, after its begin [s]."""
        most = self.speed_m_s, self.acceleration_m_s2
        return trapezoid_times_s(lengths_m, turns_m, shares, most)


@compiled
def trapezoid_times_s(
    lengths_m: Floats, turns_m: Floats, shares: Floats, most: tuple[float, float]
) -> Floats:
    """`TrapezoidPace.times_s` for the greatest speed [m/s] and the acceleration [m/s2]."""
    speed_m_s, acceleration_m_s2 = most
    ways_m = np.sqrt(lengths_m**2 + turns_m**2)
    ramps_m = np.minimum(ways_m / 2, speed_m_s**2 / (2 * acceleration_m_s2))
    ramps_s = np.sqrt(2 * ramps_m / acceleration_m_s2)
    durations_s = 2 * ramps_s + (ways_m - 2 * ramps_m) / speed_m_s
    done_m = shares * ways_m
    nearer_m = np.minimum(done_m, ways_m - done_m)
    on_ramp_s = np.sqrt(2 * np.maximum(np.minimum(nearer_m, ramps_m), 0.0) / acceleration_m_s2)
    from_end_s = on_ramp_s + np.maximum(nearer_m - ramps_m, 0.0) / speed_m_s
    times_s: Floats = np.where(2 * done_m <= ways_m, from_end_s, durations_s - from_end_s)
    return times_s


#: A tile left and met again within this is met all the while [m].
_SAME_M = 1e-9


class Visits(NamedTuple):
    """Tiles of a route (V,), from one path coordinate [m] and planned time [s] to another.

    A tile on which the parcel is at the end has inf as path coordinate: it is left by being gone.
    """

    tile: Ints
    enters_m: Floats
    leaves_m: Floats
    enters_s: Floats
    leaves_s: Floats


@dataclass(frozen=True)
class Route:
    """Where a parcel goes: `poses` (K, 3) [m, m, rad; table frame], x, y and yaw linear between.

    Move k leads from pose k to pose k + 1, at rest at both, and is planned from `begins_s[k]` to
    `arrives_s[k]`. Path coordinates `along_m` (K,) count from the first pose: the way of the centre
    and that of the farthest corner's turning, hypot of both, `reach_m` from the centre.
    """

    parcel: str
    poses: Floats
    along_m: Floats
    begins_s: Floats
    arrives_s: Floats
    visits: Visits
    reach_m: float

    @property
    def length_m(self) -> float:
        """The path coordinate of the end [m]."""
        return float(self.along_m[-1])

    @property
    def end_s(self) -> float:
        """When the parcel is planned to be at the end [s]; -inf when it is there already."""
        return float(self.arrives_s[-1]) if len(self.arrives_s) else -np.inf

    @property
    def stays(self) -> Ints:
        """The tiles on which the parcel is at the end for good."""
        stays: Ints = self.visits.tile[np.isinf(self.visits.leaves_s)]
        return stays

    def pose_at(self, along_m: float) -> Floats:
        """The pose at a path coordinate, shape (3,)."""
        columns = [np.interp(along_m, self.along_m, column) for column in self.poses.T]
        return np.array(columns)

    def meets(self, tiles: Ints, from_m: float = 0.0) -> bool:
        """Whether the parcel is on any of these tiles, from a path coordinate on."""
        return bool((among(self.visits.tile, tiles) & (self.visits.leaves_m > from_m)).any())

    def ahead(self, along_m: float, until_m: float) -> Floats:
        """The poses from one path coordinate to another, both ends' too, shape (K, 3)."""
        between = (self.along_m > along_m + _SAME_M) & (self.along_m < until_m - _SAME_M)
        ends = [self.pose_at(along_m)], [self.pose_at(until_m)]
        return np.concatenate([ends[0], self.poses[between], ends[1]])

    def ahead_s(self, along_m: float, until_m: float) -> Floats:
        """When it is planned at each of the poses `ahead` [s], shape (K,)."""
        if not len(self.arrives_s):
            return np.full(2, self.end_s)
        planned_s = np.concatenate((self.begins_s[:1], self.arrives_s))
        between = (self.along_m > along_m + _SAME_M) & (self.along_m < until_m - _SAME_M)
        ends_s = np.interp([along_m, until_m], self.along_m, planned_s)
        return np.concatenate((ends_s[:1], planned_s[between], ends_s[1:]))


def among(tiles: Ints, some: Ints) -> Bools:
    """Which of these tiles are among a few others, (V,); sooner than `np.isin` for so few."""
    found: Bools = (tiles[:, None] == some).any(axis=1)
    return found


def merged(
    visits: Visits,
    rests: Sequence[tuple[float, Ints]],
    stand: Ints,
    end_m: float,
    gone_s: float,
) -> Visits:
    """Visits of the moves of a route, in any order, with one for each time a tile is met.

    Where it `rests` between moves, at path coordinates, no tiles but those given are under it.
    The tiles `stand` under it at the end are left at `gone_s`, when it is taken off the table; inf:
    never.
    """
    order = np.lexsort((visits.enters_m, visits.tile))
    tile, enters_m, leaves_m = visits.tile[order], visits.enters_m[order], visits.leaves_m[order]
    enters_s, leaves_s = visits.enters_s[order], visits.leaves_s[order]
    # A turn is taken to sweep a little more than stays under the parcel when it ends or begins.
    stays = (leaves_m >= end_m - _SAME_M) & among(tile, stand)
    leaves_m, leaves_s = np.where(stays, np.inf, leaves_m), np.where(stays, gone_s, leaves_s)
    new = np.ones(len(tile), dtype=bool)
    new[1:] = (tile[1:] != tile[:-1]) | (enters_m[1:] > leaves_m[:-1] + _SAME_M)
    for rest_m, under in rests:
        # Others may pass meanwhile: as one visit, each would be before the other.
        new[1:] |= (np.abs(enters_m[1:] - rest_m) <= _SAME_M) & ~among(tile[1:], under)
    first = np.flatnonzero(new)
    if not len(first):
        return Visits(tile, enters_m, leaves_m, enters_s, leaves_s)
    return Visits(
        tile[first],
        enters_m[first],
        np.maximum.reduceat(leaves_m, first),
        enters_s[first],
        np.maximum.reduceat(leaves_s, first),
    )
