"""A parcel that its cells believe elsewhere than the host does, and steer by that.

Cells that lose a parcel keep for a while where they had it. Where it is set down again meanwhile,
that may suit the sensors of some of them as well: these steer it by the old place, and others by
the one where it is.
"""

from collections.abc import Collection, Mapping
from math import hypot, inf

from mdms_host.estimation.footprint import Bottom
from mdms_model.arrays import Floats

#: Cells are off by so much, a corner's way included [m]: by more than host and cells may be off at
#: rest, and by less than places are apart that suit the same sensors.
_OFF_M = 0.05
#: One alone may be wrong about its own place, and is left out by the others.
_CELLS = 2
#: A disagreement that does not last so long comes of late frames [s].
_LASTS_S = 0.1

Pose = tuple[float, float, float]


class Elsewhere:
    """Looks at one parcel of this bottom."""

    def __init__(self, bottom: Bottom) -> None:
        self._bottom = bottom
        self._since_s = inf

    def step(
        self, pose: Floats | None, theirs: Mapping[int, Pose], now_s: float
    ) -> Collection[int]:
        """The cells that have been wrong about a parcel for too long, once each time.

        `pose` is the host's, shape (3,), None while it is not sure of it; `theirs` are those that
        cells (from 1) steer it by.
        """
        wrong = [
            cell
            for cell, its in theirs.items()
            if pose is not None and self._off_m(pose, its) > _OFF_M
        ]
        if len(wrong) < _CELLS:
            self._since_s = inf
            return ()
        self._since_s = min(self._since_s, now_s)
        if now_s - self._since_s < _LASTS_S:
            return ()
        self._since_s = inf
        return wrong

    def _off_m(self, pose: Floats, its: Pose) -> float:
        x_m, y_m, yaw_rad = pose.tolist()
        turn_rad = self._bottom.nearest_yaw_rad(its[2], yaw_rad) - yaw_rad
        return hypot(its[0] - x_m, its[1] - y_m, turn_rad * self._bottom.reach_m)
