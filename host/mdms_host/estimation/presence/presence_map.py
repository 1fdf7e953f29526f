"""State of all presence sensors: covered or free, how old that is, and the worth of each."""

from collections.abc import Collection, Iterator, Sequence
from math import inf

import numpy as np

from mdms_host.estimation.presence.sensor_worth import SensorWorth
from mdms_model.arrays import Bools, Floats

#: The bits of a cell are valid for so many of the periods in which it repeats them.
_PERIODS = 3.0
#: A report that comes so long after it was due follows a lost one [s].
_LATE_S = 0.02
#: A sensor is judged from this far inside or outside all parcels on [m].
_DEEP_M = 0.02
#: Of a longer time since the last judgement nothing is known [s].
_JUDGED_S = 0.05
#: Sensors are judged where at least this share of those under parcels is covered.
_AGREEING = 0.8


class PresenceMap:
    """The presence sensors of so many cells, all in a row, shape (S,).

    `covered` is the state of each, `changed_s` (S,) its last change, and `late_s` (S,) the last
    time a change was learned after a lost report. Cells repeat their bits every `status_period_s`,
    and report changes `debounce_s` late.
    """

    def __init__(
        self, cells: int, sensors: int, status_period_s: float, debounce_s: Sequence[float]
    ) -> None:
        self.covered: Bools = np.zeros(cells * sensors, dtype=bool)
        self.changed_s: Floats = np.full(cells * sensors, -inf)
        self.late_s: Floats = np.full(cells * sensors, -inf)
        self._sensors = sensors
        self._bits: list[int | None] = [None] * cells
        self._reported_s = np.full(cells, -inf)
        self._period_s = status_period_s
        self._valid_s = _PERIODS * status_period_s
        self._debounce_s = tuple(debounce_s) or (0.0,) * cells
        self._worth = SensorWorth(cells * sensors)
        self._judged_s = inf
        self._ignored: Collection[int] = ()
        self._counted: Bools = np.ones(cells * sensors, dtype=bool)

    @property
    def complete(self) -> bool:
        """Whether every cell has reported, but for those that are ignored."""
        silent = (cell for cell, bits in enumerate(self._bits, 1) if bits is None)
        return all(cell in self._ignored for cell in silent)

    def ignore(self, cells: Collection[int]) -> None:
        """These cells (from 1) show nothing, whatever they report or have reported; others do."""
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
        timely = now_s - self._reported_s[cell - 1] <= self._period_s + _LATE_S
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
            if not timely:
                self.late_s[first + place] = now_s
            if before is not None and timely and self._worth.believed[first + place]:
                yield now_s - self._debounce_s[cell - 1], first + place

    def valid(self, now_s: float) -> Bools:
        """Sensors that are believed, and whose cells have reported of late, shape (S,)."""
        return self._current(now_s) & self._worth.believed

    def silent_s(self, now_s: float) -> Floats:
        """Age of the last reported state of each sensor [s], shape (S,)."""
        seen_s = self._reported_s - np.array(self._debounce_s)
        return np.repeat(now_s - seen_s, self._sensors)

    def _current(self, now_s: float) -> Bools:
        """Sensors whose cells have reported of late, and are not ignored, shape (S,)."""
        lately = now_s - self._reported_s <= self._valid_s
        return np.repeat(lately, self._sensors) & self._counted

    def judge(self, now_s: float, distance_m: Floats, other: Bools) -> list[tuple[int, list[int]]]:
        """Compare with the places of all parcels: `distance_m` (S,) from the nearest edge.

        All parcels must be found. Nothing is expected of sensors that show something `other` than
        parcels, (S,), and states that have not been reported of late are not judged.

        Returns cells (from 1) with their sensors (from 0) that are not believed from now on.
        """
        step_s = min(max(0.0, now_s - self._judged_s), _JUDGED_S)
        self._judged_s = now_s
        deep = ~other & self._current(now_s) & (abs(distance_m) > _DEEP_M)
        inside = deep & (distance_m < 0)
        if (self.covered & inside).sum() < _AGREEING * inside.sum():
            return []
        wrong = deep & (inside != self.covered)
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
        return self._by_cell(sensors)

    def believe(self, sensors: Bools) -> None:
        """Believe these sensors (S,) again: the parcel that they contradicted was not there."""
        self._worth.believe(sensors)

    def _by_cell(self, sensors: list[int]) -> list[tuple[int, list[int]]]:
        cells: dict[int, list[int]] = {}
        for sensor in sensors:
            cell, place = divmod(sensor, self._sensors)
            cells.setdefault(cell + 1, []).append(place)
        return list(cells.items())
