"""The presence sensors: their states, their ages, their worth, and those that lie together.

`Surroundings` are the sensors and wheels of the cells around a place, so that nothing looks at a
whole table.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil, floor, hypot, inf

import numpy as np

from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats, Ints

#: A sensor is not believed any more once it has been wrong for so long [s]; where it is right it
#: makes up for that this many times slower, up to the limit.
_WRONG_S = 0.3
_SLOWER = 10.0
_MOST_S = 1.0


class SensorReliability:
    """How long each of so many sensors has been wrong of late; `believed` is of shape (S,)."""

    def __init__(self, sensors: int) -> None:
        self.believed: Bools = np.ones(sensors, dtype=bool)
        self._wrong_s: Floats = np.zeros(sensors)

    def step(self, wrong: Bools, right: Bools, step_s: float) -> list[int]:
        """Take in which sensors are wrong, and right; those not believed from now on."""
        if not (wrong.any() or self._wrong_s.any()):
            return []  # as nearly always
        change_s = step_s * (wrong.astype(np.float64) - right / _SLOWER)
        return self._settle(np.clip(self._wrong_s + change_s, 0.0, _MOST_S))

    def disbelieve(self, sensors: Bools) -> list[int]:
        """These have been found wrong; those of them that were believed until now."""
        return self._settle(np.where(sensors, _MOST_S, self._wrong_s))

    def believe(self, sensors: Bools) -> None:
        """These have been found right."""
        self._settle(np.where(sensors, 0.0, self._wrong_s))

    def _settle(self, wrong_s: Floats) -> list[int]:
        self._wrong_s = wrong_s
        believed = wrong_s < _WRONG_S
        fallen = self.believed & ~believed
        self.believed = believed
        return [int(sensor) for sensor in np.flatnonzero(fallen)]


#: The bits of a cell are valid for so many of the periods in which it repeats them.
_PERIODS = 3.0
#: A report that comes so long after it was due follows a lost one [s].
_LATE_S = 0.02
#: Where a frame has got lost, so may others for so long [s].
_LOSSY_S = 1.0
#: A sensor is judged from this far inside or outside all parcels on [m].
_DEEP_M = 0.02
#: Of a longer time since the last judgement nothing is known [s].
_JUDGED_S = 0.05
#: Where each sensor turns wrong and back more often [Hz], as a mean over so long [s], edges show no
#: place.
_NOISY_HZ = 0.02
_NOISE_S = 2.0
#: Sensors are judged where at least this share of those under parcels is covered.
_AGREEING = 0.8


class PresenceMap:
    """The presence sensors of so many cells, all in a row, shape (S,).

    `covered` is the state of each. Its last change was learned at `changed_s` (S,), and was at
    `since_s` (S,) or later. That is the time of the report before, if one between may be lost.
    Cells repeat their bits every `status_period_s`, and report changes `debounce_s` late.
    """

    def __init__(
        self, cells: int, sensors: int, status_period_s: float, debounce_s: Sequence[float]
    ) -> None:
        self.covered: Bools = np.zeros(cells * sensors, dtype=bool)
        self.changed_s: Floats = np.full(cells * sensors, -inf)
        self.since_s: Floats = np.full(cells * sensors, -inf)
        self._sensors = sensors
        self._bits: list[int | None] = [None] * cells
        self._reported_s = np.full(cells, -inf)
        self._lost_s = self._deaf_s = -inf
        self._wrong: Bools = np.zeros(cells * sensors, dtype=bool)
        self._judged: Bools = self.covered.copy()
        self._noise_hz = 0.0
        self._period_s = status_period_s
        self._valid_s = _PERIODS * status_period_s
        self._debounce_s: Floats = np.array(tuple(debounce_s) or (0.0,) * cells)
        self._worth = SensorReliability(cells * sensors)
        self._judged_s = inf
        self._ignored: Collection[int] = ()
        self._counted: Bools = np.ones(cells * sensors, dtype=bool)

    @property
    def complete(self) -> bool:
        """Whether every cell has reported, but for those that are ignored."""
        if None not in self._bits:
            return True
        silent = (cell for cell, bits in enumerate(self._bits, 1) if bits is None)
        return all(cell in self._ignored for cell in silent)

    def ignore(self, cells: Collection[int]) -> None:
        """Ignore all reports of these cells (from 1), earlier ones too; others count again."""
        self._ignored = cells
        self._counted[:] = True
        for cell in cells:
            self._counted[(cell - 1) * self._sensors : cell * self._sensors] = False

    def on_report(self, now_s: float, cell: int, bits: int) -> Iterator[tuple[float, int]]:
        """Cell `cell` (from 1) reports bit k for its sensor k; when each sensor changed [s].

        Sensors that are not believed are left out, and all where a report has got lost before: one
        of them may have changed then, and not now.
        """
        before, bits = self._bits[cell - 1], bits & (1 << self._sensors) - 1
        reported_s = float(self._reported_s[cell - 1])
        timely = self._deaf_s <= reported_s and now_s - reported_s <= self._period_s + _LATE_S
        lossy = not timely or self._is_lossy(now_s)
        self._reported_s[cell - 1] = now_s
        if bits == before:
            return
        self._bits[cell - 1] = bits
        first = (cell - 1) * self._sensors
        for place in range(self._sensors):
            if before is not None and not (bits ^ before) >> place & 1:
                continue
            self.covered[first + place] = bits >> place & 1
            self.changed_s[first + place] = now_s
            self.since_s[first + place] = reported_s if lossy else now_s
            if before is not None and timely and self._worth.believed[first + place]:
                yield now_s - float(self._debounce_s[cell - 1]), first + place

    def on_loss(self, now_s: float) -> None:
        """A frame of some cell has got lost."""
        self._lost_s = now_s

    def on_deafness(self, now_s: float) -> None:
        """Nothing was heard of any cell for a while: reports of changes have got lost."""
        self._deaf_s = now_s

    def may_be_old(self, now_s: float) -> Bools:
        """Sensors that may have changed unheard: a report has got lost, or may have, shape (S,)."""
        overdue = now_s - self._reported_s > self._period_s + _LATE_S
        unheard = overdue | (self._reported_s < self._deaf_s) | self._is_lossy(now_s)
        return unheard.repeat(self._sensors)

    def _is_lossy(self, now_s: float) -> bool:
        return now_s < self._lost_s + _LOSSY_S

    def valid(self, now_s: float) -> Bools:
        """Sensors that are believed, and whose cells have reported of late, shape (S,)."""
        return self._current(now_s) & self._worth.believed

    def mute(self, now_s: float) -> Bools:
        """Sensors whose cells have not reported of late, or are ignored, shape (S,)."""
        return ~self._current(now_s)

    @property
    def noisy(self) -> bool:
        """Whether sensors turn wrong too often to show where a parcel is."""
        return self._noise_hz > _NOISY_HZ

    def silent_s(self, now_s: float) -> Floats:
        """Age of the last reported state of each sensor [s], shape (S,)."""
        return (now_s - (self._reported_s - self._debounce_s)).repeat(self._sensors)

    def _current(self, now_s: float) -> Bools:
        """Sensors whose cells have reported of late, and are not ignored, shape (S,)."""
        lately = now_s - self._reported_s <= self._valid_s
        return lately.repeat(self._sensors) & self._counted

    def judge(
        self, now_s: float, distance_m: Floats, other: Bools, alone: Bools
    ) -> list[tuple[int, list[int]]]:
        """Compare with the places of all parcels: `distance_m` (S,) from the nearest edge.

        All parcels must be found. Nothing is expected of sensors that show something `other` than
        parcels, (S,), and states that have not been reported of late are not judged. Sensors near
        an edge are judged only where their cell contradicts `alone`, (S,).

        Returns cells (from 1) with their sensors (from 0) that are not believed from now on.
        """
        if now_s > self._judged_s + _JUDGED_S:
            self._wrong[:] = False
        step_s = min(max(0.0, now_s - self._judged_s), _JUDGED_S)
        self._judged_s = now_s
        deep = ~other & self._current(now_s) & ((abs(distance_m) > _DEEP_M) | alone)
        inside = deep & (distance_m < 0)
        wrong = deep & (inside != self.covered)
        # A newcomer covers sensors as well, but these stay so until it has been found.
        back = deep & self._wrong & ~wrong & (self.covered != self._judged)
        self._wrong, self._judged = wrong, self.covered.copy()
        self._noise_hz *= 1.0 - step_s / _NOISE_S
        self._noise_hz += int(back.sum()) / max(1, int(deep.sum())) / _NOISE_S
        others = inside & ~alone
        if (self.covered & others).sum() < _AGREEING * others.sum():
            return []
        return self._fallen(self._worth.step(wrong, deep & ~wrong, step_s))

    def disbelieve(self, sensors: Bools) -> list[tuple[int, list[int]]]:
        """Believe these sensors (S,) no more for now; returns as `judge` does."""
        return self._fallen(self._worth.disbelieve(sensors))

    def _fallen(self, sensors: list[int]) -> list[tuple[int, list[int]]]:
        """Sensors that are not believed any more; where most of a cell are not, none of it is.

        Such a cell may be in another's place: what seems right there is so by chance.
        """
        if sensors:
            wrong = ~self._worth.believed.reshape(-1, self._sensors)
            broken = wrong.sum(axis=1) * 2 > self._sensors
            whole = np.repeat(broken, self._sensors)
            sensors = sorted({*sensors, *self._worth.disbelieve(whole & self._worth.believed)})
        cells: dict[int, list[int]] = {}
        for sensor in sensors:
            cell, place = divmod(sensor, self._sensors)
            cells.setdefault(cell + 1, []).append(place)
        return list(cells.items())

    def believe(self, sensors: Bools) -> None:
        """Believe these sensors (S,) again: the parcel that they contradicted was not there."""
        self._worth.believe(sensors)


#: So many are kept; parcels come through few cells at a time.
_KEPT = 512


@dataclass(frozen=True, slots=True)
class Near:
    """Numbers and places of N sensors and of V wheels, and the speeds that a twist gives them.

    `jacobian` maps a twist about the table's origin to the speeds of these wheels, shape (V, 3).
    """

    sensors: Ints
    sensors_m: Floats
    wheels: Ints
    wheels_m: Floats
    jacobian: Floats

    def surface_jacobian(self, pose: Floats) -> Floats:
        """The same for a twist about the place of a pose."""
        x_m, y_m, _ = pose.tolist()
        about_point = np.array([[1.0, 0.0, y_m], [0.0, 1.0, -x_m], [0.0, 0.0, 1.0]])
        jacobian: Floats = self.jacobian @ about_point
        return jacobian


class Surroundings:
    """Finds the cells near places of a layout, whose sensors are at `sensors_m` (S, 2)."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._shape = layout.rows, layout.columns
        self.sensors_m = layout.sensors_m
        self._jacobian = layout.surface_jacobian(0.0, 0.0)
        offsets_m = [*layout.sensor_offsets_m, *(wheel.offset_m for wheel in layout.wheels)]
        self._offset_m = float(np.abs(offsets_m).max())
        self._kept: dict[tuple[int, int, int, int], Near] = {}

    def of(self, place_m: Floats, reach_m: float) -> Near:
        """All sensors and wheels within `reach_m` of a place (2,), and some more."""
        x_m, y_m = place_m.tolist()
        reach_m += self._offset_m
        rows, columns = self._shape
        key = (*self._span(y_m, reach_m, rows), *self._span(x_m, reach_m, columns))
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            self._kept[key] = self._cut(*key)
        return self._kept[key]

    def _span(self, place_m: float, reach_m: float, count: int) -> tuple[int, int]:
        """From which to which row or column cells lie within reach; none: the same twice."""
        middle, pitch_m = (count - 1) / 2, self._layout.pitch_m
        first = max(0, ceil((place_m - reach_m) / pitch_m + middle))
        last = min(count, floor((place_m + reach_m) / pitch_m + middle) + 1)
        return first, max(first, last)

    def _cut(self, footprint: int, top: int, left: int, right: int) -> Near:
        layout = self._layout
        cells = np.arange(layout.cells).reshape(self._shape)[footprint:top, left:right].ravel()
        sensors = _members(cells, len(layout.sensor_offsets_m))
        wheels = _members(cells, len(layout.wheels))
        return Near(
            sensors,
            self.sensors_m[sensors],
            wheels,
            layout.wheel_positions_m[wheels],
            self._jacobian[wheels],
        )


def _members(cells: Ints, each: int) -> Ints:
    members: Ints = (cells[:, None] * each + np.arange(each)).ravel()
    return members


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
