"""How large a rectangular parcel may be, from the sensors that it covers, and leaves free."""

from dataclasses import dataclass

import numpy as np

from mdms_host.estimation.parcel import Parcel
from mdms_model.arrays import Floats

_YAW_STEP_RAD = np.radians(1.0)
_QUARTER = 90
#: Where no sensor bounds a side it is taken to reach so far beyond the covered ones [m].
_OPEN_M = 0.1


@dataclass(frozen=True, slots=True)
class Size:
    """A rectangle: its likeliest sides, and one standard deviation of each [m].

    `yaw_rad` is the direction of its length [table frame].
    """

    length_m: float
    width_m: float
    deviation_m: tuple[float, float]
    yaw_rad: float

    def parcel(self, name: str) -> Parcel:
        """A parcel of this size, which is learned better as edges pass sensors."""
        spread_m = max(self.deviation_m) / 2
        return Parcel(
            name, self.length_m, self.width_m, yaw_hint_rad=self.yaw_rad, spread_m=spread_m
        )


def size_of(covered_m: Floats, free_m: Floats) -> Size | None:
    """The size of what covers the sensors (C, 2) but not (F, 2); None if that is no rectangle.

    The longer side is called length. All rectangles that the sensors allow count alike.
    """
    yaws_rad = np.arange(2 * _QUARTER) * _YAW_STEP_RAD
    rows = [_at_yaw(float(yaw), covered_m, free_m) for yaw in yaws_rad]
    gaps_m = np.array([row[1] for row in rows])
    weights = np.prod(gaps_m, axis=1)
    if not weights.any():
        return None
    # Each rectangle appears twice, a quarter turned: the likeliest one's neighbours are of a kind.
    best = int(np.argmax(weights))
    run = np.arange(best - _QUARTER // 2, best + _QUARTER // 2) % len(rows)
    turned_rad = yaws_rad[best] + (np.arange(len(run)) - _QUARTER // 2) * _YAW_STEP_RAD
    share = weights[run] / weights[run].sum()
    extents_m = np.array([rows[number][0] for number in run])
    along_m, across_m = gaps_m[run][:, :2], gaps_m[run][:, 2:]
    slack_m = np.column_stack((along_m.sum(axis=1), across_m.sum(axis=1)))
    sides_m = extents_m + slack_m / 2
    mean_m = share @ sides_m
    within = np.column_stack(((along_m**2).sum(axis=1), (across_m**2).sum(axis=1))) / 12
    deviation_m = np.sqrt(share @ (within + (sides_m - mean_m) ** 2))
    yaw_rad = float(share @ turned_rad)
    columns = (mean_m, deviation_m)
    if mean_m[1] > mean_m[0]:
        columns = tuple(column[::-1] for column in columns)
        yaw_rad += np.pi / 2
    (length_m, width_m), deviation = (column.tolist() for column in columns)
    yaw_rad = (yaw_rad + np.pi / 2) % np.pi - np.pi / 2
    return Size(length_m, width_m, (deviation[0], deviation[1]), yaw_rad)


def rectangles_of(
    covered_m: Floats, free_m: Floats, yaw_rad: float, count: int
) -> tuple[Floats, Floats]:
    """Rectangles that cover the sensors (C, 2) but not (F, 2), drawn as if all counted alike.

    Poses (N, 3) [m, m, rad; table frame] within an eighth of a turn of a yaw, and sides (N, 2) [m],
    `count` of them; none if there are no such.
    """
    chance = np.random.default_rng(0)
    yaws_rad = yaw_rad + (np.arange(_QUARTER) - _QUARTER // 2) * _YAW_STEP_RAD
    rows = [_at_yaw(float(yaw), covered_m, free_m) for yaw in yaws_rad]
    gaps_m = np.array([row[1] for row in rows])
    weights = np.prod(gaps_m, axis=1)
    if not weights.any():
        return np.empty((0, 3)), np.empty((0, 2))
    which = chance.choice(len(rows), count, p=weights / weights.sum())
    # Each side lies anywhere between the covered sensors and the free ones: low and high, along
    # and across.
    out_m = gaps_m[which] * chance.uniform(0.0, 1.0, (count, 4))
    extents_m = np.array([row[0] for row in rows])[which]
    sides_m = extents_m + out_m[:, ::2] + out_m[:, 1::2]
    poses = np.empty((count, 3))
    poses[:, 2] = yaws_rad[which]
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    low_m = np.array(
        [
            (covered_m @ np.array([[c, -s], [s, c]])).min(axis=0)
            for c, s in zip(cosine.tolist(), sine.tolist(), strict=True)
        ]
    )
    x_m, y_m = (low_m - out_m[:, ::2] + sides_m / 2).T
    poses[:, 0], poses[:, 1] = cosine * x_m - sine * y_m, sine * x_m + cosine * y_m
    return poses, sides_m


def _at_yaw(yaw_rad: float, covered_m: Floats, free_m: Floats) -> tuple[list[float], list[float]]:
    """The least extents of a rectangle of this yaw, and how far each of its four sides may move."""
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    own_m, own_free_m = covered_m @ turn, free_m @ turn
    low_m, high_m = own_m.min(axis=0), own_m.max(axis=0)
    level = (own_free_m >= low_m) & (own_free_m <= high_m)
    if level.all(axis=1).any():
        return [0.0, 0.0], [0.0] * 4
    gaps_m = []
    for axis in (0, 1):
        beside_m = own_free_m[level[:, 1 - axis], axis]
        below, above = beside_m[beside_m < low_m[axis]], beside_m[beside_m > high_m[axis]]
        gaps_m.append(float(low_m[axis] - below.max()) if len(below) else _OPEN_M)
        gaps_m.append(float(above.min() - high_m[axis]) if len(above) else _OPEN_M)
    return (high_m - low_m).tolist(), gaps_m
