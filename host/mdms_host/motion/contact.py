"""Parcels that press each other, and unknown things that parcels keep clear of.

Both are judged from believed outlines and commanded twists.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from math import hypot

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Footprint
from mdms_host.motion.trajectory.path import Path
from mdms_model import outline
from mdms_model.arrays import Floats

#: Beliefs that overlap by less may be of parcels that pass each other; by more they are not.
_OVERLAP_M = 0.005
_DEEP_M = 0.02
#: Between the two it must be at least this share of the way ahead that brings them closer.
_CLOSING_SHARE = 0.3
#: A way to a stop may be longer by this factor, and beliefs may be off: a parcel looks so much
#: farther ahead along its way [m].
_LONGER = 1.3
_AHEAD_M = 0.02
#: Room that a parcel needs around it to turn on the spot, and beside its way to go around [m].
_NEAR_M = 0.015
_BESIDE_M = 0.05
#: How long two parcels must be on their way into each other.
_PRESSING_S = 0.05


@dataclass(frozen=True, slots=True)
class MovingBody:
    """A parcel's outline, believed pose, commanded twist, and the time it takes to stop [s].

    `way` is the rest of its way, which begins at its place; None where it only comes to rest.
    """

    outline: Footprint
    pose: Floats
    twist: Floats
    stopping_s: float
    way: Path | None = None

    @property
    def moves(self) -> bool:
        """Whether it moves, or is about to."""
        return self.way is not None or bool(self.twist.any())

    @property
    def ahead_m(self) -> float:
        """How far it looks ahead, turning counted by the way of a corner [m]."""
        if self.way is None:
            return self.stopping_m
        return min(_LONGER * self.stopping_m + _AHEAD_M, self.way.length_m)

    @property
    def ahead_pose(self) -> Floats:
        """Where it comes so far ahead: where it lies once it stands, or farther, shape (3,)."""
        if self.way is None:
            return self.pose + self.twist * (self.stopping_s / 2)
        return self.way.pose_at(self.ahead_m)

    @property
    def stopping_m(self) -> float:
        """The way to a stop, turning counted by that of a corner [m]."""
        vx_m_s, vy_m_s, rate_rad_s = self.twist.tolist()
        corner_m_s: float = abs(rate_rad_s) * self.outline.reach_m
        return 0.5 * self.stopping_s * (hypot(vx_m_s, vy_m_s) + corner_m_s)


class Contacts:
    """Watches all pairs of parcels."""

    def __init__(self) -> None:
        self._pressing_s: dict[tuple[str, str], float] = {}

    def step(self, bodies: Mapping[str, MovingBody], step_s: float) -> Iterator[tuple[str, str]]:
        """Take in all parcels; names of two that press each other, or cannot avoid it any more."""
        for pair in combinations(bodies, 2):
            one, other = (bodies[name] for name in pair)
            pressing_s = self._pressing_s.get(pair, 0.0) + step_s if press(one, other) else 0.0
            self._pressing_s[pair] = pressing_s
            if pressing_s >= _PRESSING_S:
                yield pair


def press(one: MovingBody, other: MovingBody) -> bool:
    """Whether two parcels overlap ahead, where they may still stop before, and more than now."""
    if not (one.moves or other.moves):
        return False
    one_pose, other_pose = one.ahead_pose, other.ahead_pose
    way_m = one.outline.reach_m + other.outline.reach_m
    if hypot(*(one_pose - other_pose)[:2].tolist()) > way_m:
        return False
    later_m = gap_m(one.outline, one_pose, other.outline, other_pose)
    closing_m = gap_m(one.outline, one.pose, other.outline, other.pose) - later_m
    if closing_m <= 0.0 or later_m >= -_OVERLAP_M:
        return False
    return later_m < -_DEEP_M or closing_m > _CLOSING_SHARE * (one.ahead_m + other.ahead_m)


def gap_m(one: Footprint, one_pose: Floats, other: Footprint, other_pose: Floats) -> float:
    """Gap between two parcels' outlines along the direction that parts them best [m]."""
    return outline.gap_m(one.outline_m(one_pose), other.outline_m(other_pose))


def has_room(
    name: str, move: Floats, places: Mapping[str, Floats], outlines: Mapping[str, Footprint]
) -> bool:
    """Whether a parcel may turn, and move so, without coming near any other that has a place."""
    mine = places[name]
    reach_m = outlines[name].reach_m + _NEAR_M + hypot(*move[:2].tolist())
    return not any(
        hypot(*(place - mine)[:2].tolist()) < reach_m + outlines[other].reach_m
        for other, place in places.items()
        if other != name
    )


def has_room_to(
    end: Floats, name: str, places: Mapping[str, Floats], outlines: Mapping[str, Footprint]
) -> bool:
    """Whether no other parcel that has a place is near the straight way of one to a pose."""
    mine, reach_m = places[name][:2], outlines[name].reach_m + _NEAR_M + _BESIDE_M
    along = end[:2] - mine
    length_m = max(hypot(*along.tolist()), _NEAR_M)
    for other, place in places.items():
        share = float((place[:2] - mine) @ along) / length_m**2
        nearest = mine + min(max(share, 0.0), 1.0) * along
        off_m = hypot(*(place[:2] - nearest).tolist())
        if other != name and off_m < reach_m + outlines[other].reach_m:
            return False
    return True


#: A parcel comes no nearer than this to an outline in which something unknown lies [m].
_CLEAR_M = 0.01
#: It is held where it would within its way to a stop and so much more, and as long as it would
#: within so much more than that [m].
_LOOKED_AHEAD_M = 0.015
_HELD_AHEAD_M = 0.03
#: Places on its way are looked at this far apart [m].
_STEP_M = 0.02


class Obstacles:
    """Holds parcels before unknown things, until these are gone; `all` are their beliefs."""

    def __init__(self) -> None:
        self.all: dict[str, Belief] = {}
        self._held: dict[str, str] = {}
        self._notices: list[str] = []

    def see(self, beliefs: Mapping[str, Belief], given: Mapping[str, object]) -> None:
        """Take in the beliefs of all things that are not among the `given` parcels."""
        self.all = {name: belief for name, belief in beliefs.items() if name not in given}

    def take_notices(self) -> list[str]:
        """Which parcels have begun to wait for what, since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def hold(self, parcel: Belief, way: Path, stopping_m: float) -> bool:
        """Whether a parcel must not go on along its way, which begins where it is.

        `stopping_m` is the way that it makes to a stop at least, a corner's way included.
        """
        held = parcel.name in self._held
        ahead_m = stopping_m + (_HELD_AHEAD_M if held else _LOOKED_AHEAD_M)
        poses = list(_poses_ahead(way, ahead_m))
        for name, obstacle in self.all.items():
            if _is_in_the_way(parcel, obstacle, poses, ahead_m):
                if not held:
                    self._notices.append(f"{parcel.name} waits: {name} is in its way")
                self._held[parcel.name] = name
                return True
        self._held.pop(parcel.name, None)
        return False


def _poses_ahead(way: Path, ahead_m: float) -> Iterator[Floats]:
    """Poses on the next `ahead_m` of a way, a corner's way included."""
    far_m = min(ahead_m, way.length_m)
    for step in range(1, int(far_m / _STEP_M) + 2):
        yield way.pose_at(min(step * _STEP_M, far_m))


def _is_in_the_way(parcel: Belief, obstacle: Belief, poses: list[Floats], ahead_m: float) -> bool:
    """Whether a parcel comes nearer to an obstacle than it may, and than it is."""
    reach_m = parcel.outline.reach_m + obstacle.outline.reach_m + _CLEAR_M + ahead_m
    if hypot(*(parcel.pose - obstacle.pose)[:2].tolist()) > reach_m:
        return False

    def apart_m(pose: Floats) -> float:
        return gap_m(parcel.outline, pose, obstacle.outline, obstacle.pose)

    return min(map(apart_m, poses)) < min(_CLEAR_M, apart_m(parcel.pose))
