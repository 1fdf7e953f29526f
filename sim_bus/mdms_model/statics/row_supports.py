"""Which wheels of a row carry a parcel, and how much each (eq 1), for every position of it.

A rigid flat bottom on equal springs loads its supports along a straight line over their places.
Where that line would pull at a support, the support lifts and the rest carry alone. As the parcel
moves, its support set is constant over a stretch of positions, and its forces are linear in them.
"""

from dataclasses import dataclass

import numpy as np

from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled

EDGE_M = 1e-9
"""Positions closer than this are one: far below what a contact has, far above rounding."""


@dataclass(frozen=True, slots=True)
class Stretches:
    """The line cut where the support set changes.

    Between `edge_m[k]` and `edge_m[k + 1]` [m; centre of the parcel] the wheels `first[k]` to
    `last[k]` carry it. Where `first[k] > last[k]`, and outside, its centre of mass has supports on
    one side at most and it tips.
    """

    edge_m: Floats
    first: Ints
    last: Ints


def stretches_of(wheel_x_m: Floats, ends_m: tuple[float, float], com_m: float) -> Stretches:
    """Stretches of a parcel from the places of its ends and its centre of mass.

    `wheel_x_m` ascends; the rest is seen from the parcel's centre, along x.
    """
    back_m, front_m = ends_m
    if len(wheel_x_m) == 0 or front_m <= back_m:
        return Stretches(np.zeros(1), np.zeros(0, np.int64), np.zeros(0, np.int64))
    return Stretches(*cut(wheel_x_m, back_m, front_m, com_m))


@compiled
def cut(
    wheel_x_m: Floats, back_m: float, front_m: float, com_m: float
) -> tuple[Floats, Ints, Ints]:
    """The arrays of `Stretches`."""
    ends = np.sort(np.concatenate((wheel_x_m - front_m, wheel_x_m - back_m)))
    edge, first, last = [ends[0] - (front_m - back_m), ends[0]], [0], [-1]
    for cover in range(len(ends) - 1):
        right_m = ends[cover + 1]
        middle_m = (ends[cover] + right_m) / 2
        head = int(np.searchsorted(wheel_x_m, middle_m + back_m))
        tail = int(np.searchsorted(wheel_x_m, middle_m + front_m)) - 1
        while edge[-1] < right_m - EDGE_M:
            i, j, stop_m = support_set(wheel_x_m, head, tail, edge[-1] + com_m)
            if i != first[-1] or j != last[-1]:
                first.append(i)
                last.append(j)
                edge.append(edge[-1])
            edge[-1] = min(stop_m - com_m, right_m)
    return np.array(edge), np.array(first), np.array(last)


@compiled
def support_set(wheel_x_m: Floats, head: int, tail: int, com_x_m: float) -> tuple[int, int, float]:
    """The covered wheels `head` to `tail` that carry just right of `com_x_m`, and up to where.

    From left to right the parcel tips, lies on the two leftmost, on more, on all that it covers,
    on the rightmost only, and tips again.
    """
    if tail <= head or com_x_m >= wheel_x_m[tail] - EDGE_M:
        return 0, -1, np.inf
    if com_x_m < wheel_x_m[head] - EDGE_M:
        return 0, -1, wheel_x_m[head]
    for j in range(head + 1, tail):
        stop_m = unloading(wheel_x_m, head, j + 1, j + 1)
        if com_x_m < stop_m - EDGE_M:
            return head, j, stop_m
    for i in range(head, tail):
        stop_m = unloading(wheel_x_m, i, tail, i)
        if com_x_m < stop_m - EDGE_M:
            return i, tail, stop_m
    return 0, -1, np.inf


@compiled
def unloading(wheel_x_m: Floats, first: int, last: int, end: int) -> float:
    """Where the centre of mass is when supports `first` to `last` leave nothing on the one `end`.

    The zero of eq (1): 1/n + (x_c - mean) (x_end - mean) / spread = 0.
    """
    mean_m, spread_m2 = spread(wheel_x_m, first, last)
    place_m: float = mean_m - spread_m2 / ((last - first + 1) * (wheel_x_m[end] - mean_m))
    return place_m


@compiled
def spread(wheel_x_m: Floats, first: int, last: int) -> tuple[float, float]:
    """Mean place [m] of the supports and the sum of their squared distances from it [m^2]."""
    mean_m, square_m2 = 0.0, 0.0
    for i in range(first, last + 1):
        mean_m += wheel_x_m[i]
    mean_m /= last - first + 1
    for i in range(first, last + 1):
        square_m2 += (wheel_x_m[i] - mean_m) ** 2
    return mean_m, square_m2
