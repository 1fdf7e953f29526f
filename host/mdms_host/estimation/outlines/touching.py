"""Two parcels that touch, and cover one group of sensors: told apart where that is no guess.

All places of either outline that cover no free sensor are tried. Two places explain the group if
each of its sensors is under one of them, and none under both.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mdms_host.estimation.outlines.bottom import Bottom
from mdms_model.arrays import Bools, Floats

#: Fineness of the places tried, and so many yaws in a step, which takes some milliseconds.
_STEP_M = 0.008
_YAW_STEP_RAD = np.radians(3.0)
_YAWS = 6
#: The grid may miss the places that explain all: so many sensors may be left.
_SPARE = 1
#: A sensor belongs to one of the two if so large a share of the ways that explain the group agree;
#: and of the group's sensors all but such a share must.
_SURE = 0.9
_OPEN_SHARE = 0.35
_LEAST = 3
#: So many sets of sensors are compared at most, those of the most places.
_SETS = 400


@dataclass(frozen=True, slots=True)
class _Places:
    """Places of one yaw that cover no free sensor, (P, 2) along its axes, and how many they do."""

    own_m: Floats
    centres_m: Floats
    counts: Floats


def tell_apart(
    one: Bottom, other: Bottom, covered_m: Floats, free_m: Floats
) -> Iterator[tuple[Bools, Bools] | None]:
    """Which of the covered sensors (C, 2) are surely under one, and under the other, (C,) each.

    `free_m` (F, 2) are the free sensors around. Yields None step by step, and both at last, if one
    way to divide the group is much likelier than any other. Of two that look the same it is
    arbitrary which is the first.
    """
    alike = one == other
    places: list[list[_Places]] = []
    for bottom in (one,) if alike else (one, other):
        places.append([])
        for some in _all_places(bottom, covered_m, free_m):
            places[-1].extend(some)
            yield None
    if alike:
        places *= 2
    most = [max((each.counts.max() for each in found), default=0.0) for found in places]
    sets = []
    for found, bottom, others in zip(places, (one, other), reversed(most), strict=True):
        # Sensors that the other cannot cover must be under this one.
        yield None
        sets.append(_sets(bottom, found, len(covered_m) - others - _SPARE, len(covered_m)))
    yield _likely(sets[0], sets[1], covered_m, alike=alike)


def _all_places(bottom: Bottom, covered_m: Floats, free_m: Floats) -> Iterator[list[_Places]]:
    """All places that cover no free sensor, some yaws at a time."""
    yaws_rad = bottom.yaws_rad(0.0, _YAW_STEP_RAD)
    for first in range(0, len(yaws_rad), _YAWS):
        some = (
            _at_yaw(bottom, yaw_rad, covered_m, free_m)
            for yaw_rad in yaws_rad[first : first + _YAWS].tolist()
        )
        yield [each for each in some if len(each.centres_m)]


def _at_yaw(bottom: Bottom, yaw_rad: float, covered_m: Floats, free_m: Floats) -> _Places:
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    own_m, own_free_m = covered_m @ turn, free_m @ turn
    along_m, across_m = (
        np.arange(own_m[:, axis].min(), own_m[:, axis].max() + _STEP_M, _STEP_M) for axis in (0, 1)
    )
    free = bottom.hidden(own_free_m, np.ones(len(own_free_m)), along_m, across_m)
    counts = bottom.hidden(own_m, np.ones(len(own_m)), along_m, across_m)
    rows, columns = np.nonzero(free == 0)
    centres_m = np.column_stack((along_m[rows], across_m[columns]))
    return _Places(own_m, centres_m, counts[rows, columns])


def _sets(
    bottom: Bottom, places: list[_Places], least: float, sensors: int
) -> tuple[Floats, Floats]:
    """Which sensors (C,) places with so many cover, all different, (N, C); how many do, (N,)."""
    masks = []
    for each in places:
        centres_m = each.centres_m[each.counts >= max(least, _LEAST)]
        if len(centres_m):
            away_m = (each.own_m[None, :, :] - centres_m[:, None, :]).reshape(-1, 2)
            inside = bottom.distance_m(away_m, np.zeros(3)) < 0
            masks.append(np.packbits(inside.reshape(len(centres_m), sensors), axis=1))
    if not masks:
        return np.zeros((0, sensors)), np.zeros(0)
    different, counts = np.unique(np.vstack(masks), axis=0, return_counts=True)
    often = np.argsort(-counts, kind="stable")[:_SETS]
    sets = np.unpackbits(different[often], axis=1, count=sensors)
    return sets.astype(np.float64), counts[often].astype(np.float64)


def _likely(
    ones: tuple[Floats, Floats], others: tuple[Floats, Floats], covered_m: Floats, *, alike: bool
) -> tuple[Bools, Bools] | None:
    """Sensors that all likely divisions of the group give to either parcel; None if too few."""
    (sets, weights), (other_sets, other_weights) = ones, others
    if not len(sets) or not len(other_sets):
        return None
    wrong = sets @ other_sets.T + (1.0 - sets) @ (1.0 - other_sets).T
    if alike:
        # Either order explains as much: the first is the one farther along the group.
        along = covered_m - covered_m.mean(axis=0)
        axis = np.linalg.eigh(along.T @ along)[1][:, -1]
        middle = (sets @ (along @ axis)) / sets.sum(axis=1)
        wrong = np.where(middle[:, None] > middle[None, :], wrong, np.inf)
    if wrong.min() > _SPARE:
        return None
    likely = np.where(wrong == wrong.min(), weights[:, None] * other_weights, 0.0)
    share = likely.sum(axis=1) @ sets / likely.sum()
    other_share = likely.sum(axis=0) @ other_sets / likely.sum()
    mine, theirs = share > _SURE, other_share > _SURE
    if (~mine & ~theirs).mean() > _OPEN_SHARE or min(mine.sum(), theirs.sum()) < _LEAST:
        return None
    return mine, theirs
