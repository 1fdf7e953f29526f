"""Distance of a parcel's centre of mass inside its support polygon, at many poses at once.

The same as `mdms_model.statics.support_margin`, which is compiled. At 40 poses that takes 0.05 to
0.08 ms. Without numba it takes 2.5 to 6 ms, a cycle's time; this takes 0.25 to 0.5 ms, always. So
the planner uses that, and checks within a cycle are here. The first and the last covered wheel of
each row have the same hull as all covered wheels.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Footprint
from mdms_host.layout import Layout
from mdms_host.motion.trajectory.pushes import by_parts
from mdms_model.arrays import Floats, Ints
from mdms_model.outline import LINE_M
from mdms_model.statics.support_margin import TIP_M

#: The centre of mass stays this far inside the hull of the supports [m].
MARGIN_M = 0.010
#: Wheels count as supports only this far under the parcel, which may be as much beside its way [m].
INSET_M = 0.002
#: A parcel is taken to be within so many deviations of where it is believed to be, but no farther
#: than this [m]. A shift is looked at in so many places.
_DEVIATIONS = 2.5
_BESIDE_M = 0.006
_SHIFTS = 8
#: Wheels at one place are one support; rows nearer to each other than this are one [m].
_SAME_M = 1e-9


class Seen(NamedTuple):
    """Wheels as a parcel has them at K poses: n of them, ordered by row and along it.

    `seen_m` (K, n, 2) is from its centre of mass [table frame], `deep_m` (K, n) from its edge
    inwards; `first` (R,) is the first wheel of each row.
    """

    seen_m: Floats
    deep_m: Floats
    first: Ints

    def ends_m(self, inset_m: float) -> Floats:
        """The ends of rows that lie so deep under the parcel, (K, 2 R, 2); NaN where none does."""
        x_m, y_m = self.seen_m[..., 0], self.seen_m[..., 1]
        under = self.deep_m >= inset_m
        low_m = np.minimum.reduceat(np.where(under, x_m, np.inf), self.first, axis=1)
        high_m = np.maximum.reduceat(np.where(under, x_m, -np.inf), self.first, axis=1)
        ends_m = np.stack(
            (np.concatenate((low_m, high_m), axis=1), np.tile(y_m[:, self.first], 2)), axis=-1
        )
        return np.where(np.isfinite(ends_m), ends_m, np.nan)


class Footholds:
    """The wheels of a layout under one parcel with its centre of mass there in its own frame."""

    def __init__(
        self, layout: Layout, footprint: Footprint, centre_of_mass_m: tuple[float, float]
    ) -> None:
        self._footprint = footprint
        self._centre_m = centre_of_mass_m
        places_m = layout.wheel_positions_m
        self._wheels_m: Floats = places_m[np.lexsort((places_m[:, 0], places_m[:, 1]))]
        self._along = _line_of(places_m)

    def margins_m(self, poses: Floats, inset_m: float) -> Floats:
        """How far the centre of mass is inside the hull of its supports at poses (K, 3), (K,).

        Wheels are supports that lie `inset_m` inside the outline; -inf where there are none.
        """
        margins_m = np.empty(len(poses))
        at = 0
        for part in by_parts(poses):
            ends_m = self._seen(part).ends_m(inset_m)
            margins_m[at : at + len(part)] = (
                _inside_m(ends_m) if self._along is None else _between_m(ends_m, self._along)
            )
            at += max(len(part) - 1, 1)
        return margins_m

    def stand(self, belief: Belief, move: Floats) -> bool:
        """Whether a parcel that is shifted so from where it is believed to be tips nowhere."""
        deviation_m = sqrt(np.linalg.eigvalsh(belief.covariance[:2, :2])[1])
        unsure_m = min(_DEVIATIONS * deviation_m, _BESIDE_M)
        poses = belief.pose + np.linspace(0.0, 1.0, _SHIFTS)[:, None] * move
        return bool((self.margins_m(poses, unsure_m) >= MARGIN_M).all())

    def _seen(self, poses: Floats) -> Seen:
        low_m = poses[:, :2].min(axis=0) - self._footprint.reach_m
        high_m = poses[:, :2].max(axis=0) + self._footprint.reach_m
        wheels_m = self._wheels_m
        near_m = wheels_m[((wheels_m >= low_m) & (wheels_m <= high_m)).all(axis=1)]
        if not len(near_m):
            near_m = wheels_m[:1]
        away_m = near_m - poses[:, None, :2]
        cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        # From the parcel's frame to the table's, (K, 2, 2).
        turned = np.stack((cosine, -sine, sine, cosine), axis=-1).reshape(-1, 2, 2)
        over_m = self._footprint.distance_m((away_m @ turned).reshape(-1, 2), np.zeros(3))
        begins = np.diff(near_m[:, 1], prepend=-np.inf) > _SAME_M
        seen_m = away_m - (turned @ self._centre_m)[:, None, :]
        return Seen(seen_m, -over_m.reshape(away_m.shape[:2]), begins.nonzero()[0])


def _line_of(wheels_m: Floats) -> Floats | None:
    """Unit vector along the line on which all wheels stand, (2,); None where they do not."""
    away_m = wheels_m - wheels_m[0]
    lengths_m = np.hypot(away_m[:, 0], away_m[:, 1])
    if lengths_m.max() <= LINE_M:
        return None
    along: Floats = away_m[lengths_m.argmax()] / lengths_m.max()
    beside_m = np.abs(away_m @ (-along[1], along[0]))
    return along if beside_m.max() <= LINE_M else None


def _between_m(ends_m: Floats, along: Floats) -> Floats:
    """How far 0 is from the ends of one row (K, n, 2), (K,); minus that from the row beside it."""
    along_m, beside_m = ends_m @ along, np.abs(ends_m @ (-along[1], along[0]))
    nothing = np.isnan(along_m)
    high_m = np.where(nothing, -np.inf, along_m).max(axis=1)
    low_m = np.where(nothing, np.inf, along_m).min(axis=1)
    off_m = np.where(nothing, 0.0, beside_m).max(axis=1)
    margins_m: Floats = np.where(off_m > TIP_M, -off_m, np.minimum(high_m, -low_m))
    return np.where(nothing.all(axis=1), -np.inf, margins_m)


def _inside_m(points_m: Floats) -> Floats:
    """How far 0 is inside the hull of points (K, n, 2) to its nearest side, (K,).

    NaN are no points. The extent of the points is least across one of the hull's sides, and a side
    joins two points. So the extent of all points across any two is taken, to either side.
    """
    one, other = np.triu_indices(points_m.shape[1], k=1)
    along_m = points_m[:, other] - points_m[:, one]
    length_m = np.hypot(along_m[..., 0], along_m[..., 1])
    across = np.stack((along_m[..., 1], -along_m[..., 0]), axis=-1)
    across /= np.where(length_m > _SAME_M, length_m, np.nan)[..., None]
    reached_m = across @ points_m.transpose(0, 2, 1)
    nothing = np.isnan(reached_m)
    most_m = np.where(nothing, -np.inf, reached_m).max(axis=2)
    least_m = np.where(nothing, np.inf, reached_m).min(axis=2)
    # Two points at one place have nothing across, and reach -inf; so do points that are NaN.
    inside_m = np.minimum(most_m, -least_m)
    margins_m: Floats = np.where(np.isinf(inside_m), np.inf, inside_m).min(axis=1)
    return np.where(np.isinf(margins_m), -np.inf, margins_m)
