"""Covered sensors that lie together: what one parcel, or several that touch, may cover."""

from itertools import product
from math import hypot, inf

import numpy as np

from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Ints

#: Sensors count as neighbours up to so many times the distance that joins all of them.
_SPARE = 1.05
_CELLS = (-1, 0, 1)


class SensorGroups:
    """The neighbours among the sensors of a layout: those within `link_m` of each other.

    That is the least distance at which all sensors hang together, with some to spare. A parcel at
    least 1.5 times as wide covers no two groups.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self.link_m = _SPARE * _joining_m(layout)
        self._neighbours = self._linked()

    def of(self, covered: Bools, bridges: Bools) -> list[Ints]:
        """Groups of the `covered` sensors (S,), as their numbers, the one of the least first.

        `bridges` (S,) show nothing: one between two covered sensors joins them.
        """
        between = bridges & (covered[self._neighbours].sum(axis=1) >= 2)
        members = covered | between
        # One more, which is never a member: where a sensor has fewer neighbours than others.
        labels = np.where(members, np.arange(len(covered)), len(covered))
        while True:
            lowest = np.minimum(labels, labels[self._neighbours].min(axis=1))
            lowest[~members] = len(covered)
            if (lowest == labels).all():
                break
            labels = lowest
        numbers = np.flatnonzero(covered)
        order = np.argsort(labels[numbers], kind="stable")
        sorted_labels = labels[numbers][order]
        starts = np.flatnonzero(np.diff(sorted_labels)) + 1
        return np.split(numbers[order], starts) if len(numbers) else []

    def _linked(self) -> Ints:
        """Numbers of each sensor's neighbours, its own where there are fewer, shape (S, K)."""
        layout = self._layout
        each = len(layout.sensor_offsets_m)
        columns, rows = np.meshgrid(np.arange(layout.columns), np.arange(layout.rows))
        column, row = columns.ravel(), rows.ravel()
        linked: list[list[Ints]] = [[] for _ in range(each)]
        for here, there, right, up in product(range(each), range(each), _CELLS, _CELLS):
            if not 0.0 < _distance_m(layout, here, there, right, up) <= self.link_m:
                continue
            inside = (column + right >= 0) & (column + right < layout.columns)
            inside &= (row + up >= 0) & (row + up < layout.rows)
            cell = np.arange(layout.cells) + right + up * layout.columns
            own = np.arange(layout.cells) * each + here
            linked[here].append(np.where(inside, cell * each + there, own))
        most = max(map(len, linked))
        table = np.empty((layout.cells, each, max(most, 1)), dtype=np.int64)
        for place, each_linked in enumerate(linked):
            table[:, place, :] = (np.arange(layout.cells) * each + place)[:, None]
            for number, numbers in enumerate(each_linked):
                table[:, place, number] = numbers
        return table.reshape(layout.cells * each, -1)


def _distance_m(layout: Layout, here: int, there: int, right: int, up: int) -> float:
    (x0_m, y0_m), (x1_m, y1_m) = layout.sensor_offsets_m[here], layout.sensor_offsets_m[there]
    return hypot(right * layout.pitch_m + x1_m - x0_m, up * layout.pitch_m + y1_m - y0_m)


def _joining_m(layout: Layout) -> float:
    """The longest link of the shortest tree over the sensors of a cell and those beside it [m]."""
    cells = product(range(min(2, layout.columns)), range(min(2, layout.rows)))
    offsets_m = layout.sensor_offsets_m
    places_m = [
        (right * layout.pitch_m + x_m, up * layout.pitch_m + y_m)
        for right, up in cells
        for x_m, y_m in offsets_m
    ]
    away_m = dict.fromkeys(places_m, inf)
    here_m, longest_m = places_m[0], 0.0
    while away_m:
        longest_m = max(longest_m, away_m.pop(here_m) if len(away_m) < len(places_m) else 0.0)
        away_m.pop(here_m, None)
        for place_m in away_m:
            gap_m = hypot(place_m[0] - here_m[0], place_m[1] - here_m[1])
            away_m[place_m] = min(away_m[place_m], gap_m)
        if away_m:
            here_m = min(away_m, key=lambda place_m: away_m[place_m])
    return longest_m or layout.pitch_m
