"""Unknown things on the table: the parcels of a program keep clear of them, and wait."""

from collections.abc import Iterator, Mapping
from math import hypot

from mdms_host.estimation.belief import Belief
from mdms_host.motion.contact import gap_m
from mdms_host.motion.trajectory.path import Path
from mdms_model.arrays import Floats

#: A parcel comes no nearer than this to an outline in which something unknown lies [m].
_CLEAR_M = 0.01
#: It is held where it would within its way to a stop and so much more, and as long as it would
#: within so much more than that [m].
_AHEAD_M = 0.015
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
        ahead_m = stopping_m + (_HELD_AHEAD_M if held else _AHEAD_M)
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
