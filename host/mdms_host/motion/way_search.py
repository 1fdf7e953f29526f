"""A way between two poses on which a parcel does not tip, even where it is not quite believed."""

from collections.abc import Iterator
from math import ceil

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.motion.footholds import BESIDE_M, INSET_M, MARGIN_M, Footholds
from mdms_host.motion.trajectory.path import Path, shorter_turn_rad
from mdms_model.arrays import Bools, Floats

#: The margin at the ends of a way is found in so many steps.
_STEPS = 6
#: A corner moves so far from one pose that is looked at to the next, at most [m].
_STEP_M = 0.006
#: Ways lead so far around a place that is not safe [m], or over it turned by so much.
_ASIDE_M = (0.025, 0.050)
_TURNED_RAD = (0.5, 1.0)
#: A metre on which the parcel might tip though it kept to its way is as bad as so many on which it
#: might only beside it, and a metre that is safe is as bad as so much of these.
_TIPPING = 5.0
_SAFE = 0.2


class WaySearch:
    """Looks for a way of a parcel from the pose where it is believed to rest to another pose.

    The straight way does if a parcel that keeps to it does not tip. It also does to an end that is
    not safe itself. Otherwise ways are tried that turn first, turn last or lead around, one a step,
    so no cycle is held up. The first safe one is taken. If there is none, the way that is safe for
    most of its length is taken.
    """

    def __init__(self, footholds: Footholds, belief: Belief, target: Floats) -> None:
        self._footholds = footholds
        self._reach_m = belief.outline.reach_m
        self._start = belief.pose
        turn_rad = shorter_turn_rad(float(belief.pose[2]), float(target[2]))
        self._end = np.array([target[0], target[1], belief.pose[2] + turn_rad])
        # How far the parcel may be beside its way: as far as both ends are safe. A start that is
        # not safe at all is to be left.
        self._goal_m = self._safe_within_m(self._end)
        self._within_m = min(self._goal_m, self._safe_within_m(self._start) or BESIDE_M)
        self._ways: Iterator[list[Floats]] | None = None
        self._best: Path | None = None
        self._least = 0.0

    def step(self) -> Path | None:
        """The way, once it is found; another one has been looked at if not."""
        if self._ways is None:
            return self._begin()
        poses = next(self._ways, None)
        if poses is None:
            return self._best
        path = Path(np.array(poses), self._reach_m)
        unsafe_m, _ = self._unsafe(path)
        badness = unsafe_m + _SAFE * path.length_m
        if badness < self._least:
            self._best, self._least = path, badness
        return None if unsafe_m else path

    def _begin(self) -> Path | None:
        """Look at the straight way."""
        path = Path(np.array([self._start, self._end]), self._reach_m)
        if self._footholds.in_line or not self._goal_m:
            return path
        if not self._tips(_poses_on(path)).any():
            return path
        unsafe_m, worst = self._unsafe(path)
        self._ways = self._around(worst)
        self._best, self._least = path, unsafe_m + _SAFE * path.length_m
        return None

    def _safe_within_m(self, pose: Floats) -> float:
        """How far the parcel may be beside a pose without tipping; 0 where it might tip there."""
        for within_m in np.linspace(BESIDE_M, INSET_M, _STEPS).tolist():
            if self._are_safe(pose[None], within_m)[0]:
                return float(within_m)
        return 0.0

    def _are_safe(self, poses: Floats, within_m: float) -> Bools:
        """Whether a parcel so far beside each of these poses (K, 3) does not tip, (K,).

        Wheels that deep inside the outline support it there, and its centre of mass is that much
        nearer to the edge of their hull.
        """
        return self._footholds.margins_m(poses, within_m) >= within_m

    def _unsafe(self, path: Path) -> tuple[float, Floats]:
        """For how much of a way the parcel is not safe, counted as above [m]; a pose amid that."""
        poses = _poses_on(path)
        unsafe = ~self._are_safe(poses, self._within_m)
        if not unsafe.any():
            return 0.0, path.start
        unsafe_poses = poses[unsafe]
        tips = int(self._tips(unsafe_poses).sum())
        unsafe_m = path.length_m / len(poses) * (len(unsafe_poses) + _TIPPING * tips)
        return unsafe_m, unsafe_poses[len(unsafe_poses) // 2]

    def _tips(self, poses: Floats) -> Bools:
        """Whether a parcel at each of these poses (K, 3) might tip there, (K,)."""
        return self._footholds.margins_m(poses, INSET_M) < MARGIN_M

    def _around(self, worst: Floats) -> Iterator[list[Floats]]:
        """Poses of ways that turn first, turn last, or lead around a pose, the shorter first."""
        start, end = self._start, self._end
        turn_rad = np.array([0.0, 0.0, end[2] - start[2]])
        yield [start, start + turn_rad, end]
        yield [start, end - turn_rad, end]
        asides = [
            np.array([sign * x, sign * y, 0.0])
            for aside_m in _ASIDE_M
            for x, y in ((aside_m, 0.0), (0.0, aside_m))
            for sign in (1, -1)
        ]
        for aside in asides:
            yield [start, worst + aside, end]
        for aside in asides:
            yield [start, start + aside, start + aside + turn_rad, end]
        for turned_rad in _TURNED_RAD:
            for sign in (1, -1):
                turn = np.array([0.0, 0.0, sign * turned_rad])
                yield [start, start + turn, end + turn, end]


def _poses_on(path: Path) -> Floats:
    """Poses on a path, `_STEP_M` apart at most, its corners among them, (K, 3)."""
    poses = [path.start[None]]
    for piece in path.pieces:
        length_m = piece.end_s_m - piece.start_s_m
        along_m = np.linspace(0.0, length_m, ceil(length_m / _STEP_M) + 1)[1:]
        poses.append(piece.start + along_m[:, None] * piece.direction)
    return np.concatenate(poses)
