"""Two parcels that touch, and cover one group of sensors: told apart where that is no guess.

All places of either outline that cover no free sensor are tried, coarsely; two of them explain the
group if they cover all of it and share no sensor.
"""

import numpy as np

from mdms_host.estimation.bottom import Bottom
from mdms_model.arrays import Bools, Floats

#: Fineness of the places tried.
_STEP_M = 0.016
_YAW_STEP_RAD = np.radians(6.0)
#: A sensor belongs to one of the two if so large a share of the ways that explain the group agree;
#: and of the group's sensors all but such a share must.
_SURE = 0.9
_OPEN_SHARE = 0.35
_LEAST = 3
#: The grid may miss the few places that explain all: so many sensors may be left.
_SPARE = 1


def tell_apart(
    one: Bottom, other: Bottom, covered_m: Floats, free_m: Floats
) -> tuple[Bools, Bools] | None:
    """Which of the covered sensors (C, 2) are surely under one, and under the other, (C,) each.

    `free_m` (F, 2) are the free sensors around. None where no way, or more than one, explains the
    group. Of two that look the same it is arbitrary which is the first.
    """
    ones, weight = _places(one, covered_m, free_m)
    same = one == other
    others, other_weight = (ones, weight) if same else _places(other, covered_m, free_m)
    if not len(ones) or not len(others):
        return None
    shared = ones @ others.T
    missed = (1.0 - ones) @ (1.0 - others).T
    wrong = shared + missed
    if same:
        # Either order explains as much: the first is the one farther along the group.
        along = covered_m - covered_m.mean(axis=0)
        axis = np.linalg.eigh(along.T @ along)[1][:, -1]
        mean = (ones @ (along @ axis)) / ones.sum(axis=1)
        wrong = wrong + 1e3 * (mean[:, None] >= mean[None, :])
    least = wrong.min()
    if least > _SPARE:
        return None
    likely = np.where(wrong == least, weight[:, None] * other_weight[None, :], 0.0)
    total = likely.sum()
    share = (likely.sum(axis=1) @ ones) / total
    other_share = (likely.sum(axis=0) @ others) / total
    mine, theirs = share > _SURE, other_share > _SURE
    open_ = (~mine & ~theirs).sum() / len(covered_m)
    if open_ > _OPEN_SHARE or min(mine.sum(), theirs.sum()) < _LEAST:
        return None
    return mine, theirs


def _places(bottom: Bottom, covered_m: Floats, free_m: Floats) -> tuple[Floats, Floats]:
    """Which covered sensors each place covers that covers no free one, (P, C), and how many do."""
    found = []
    for yaw_rad in bottom.yaws_rad(0.0, _YAW_STEP_RAD).tolist():
        cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        own_m, own_free_m = covered_m @ turn, free_m @ turn
        along_m, across_m = (
            np.arange(own_m[:, axis].min(), own_m[:, axis].max() + _STEP_M, _STEP_M)
            for axis in (0, 1)
        )
        allowed = bottom.hidden(own_free_m, np.ones(len(own_free_m)), along_m, across_m) == 0
        rows, columns = np.nonzero(allowed)
        centres_m = np.column_stack((along_m[rows], across_m[columns]))
        if len(centres_m):
            away_m = (own_m[None, :, :] - centres_m[:, None, :]).reshape(-1, 2)
            inside = bottom.distance_m(away_m, np.zeros(3)) < 0
            found.append(inside.reshape(len(centres_m), -1))
    if not found:
        return np.zeros((0, len(covered_m))), np.zeros(0)
    masks, counts = np.unique(np.packbits(np.vstack(found), axis=1), axis=0, return_counts=True)
    sets = np.unpackbits(masks, axis=1, count=len(covered_m)).astype(np.float64)
    some = sets.sum(axis=1) >= _LEAST
    return sets[some], counts[some].astype(np.float64)
