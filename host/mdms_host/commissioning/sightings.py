"""Where cells lie to each other, from what their sensors see of a plate that is moved over them.

Of two cells that see the plate at the same time, each sees the part of it that is nearer to the
other: the covered sensors of the western one lie further east in their cell than those of the
eastern one. The difference of their centres, added up over all that is seen, points from one cell
to the other. All cells are taken to be mounted the same way round.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from mdms_model.arrays import Floats

#: Column and row, from 1.
Spot = tuple[int, int]

#: A component that is so much smaller than the other counts as none: a little less than tan 22.5.
_ALONG = 0.4
#: How many sights a pair needs before it counts.
_SIGHTS_MIN = 2


class SightingError(ValueError):
    """The sightings fit no grid; the message has the cells, and advice."""


class Sightings:
    """Sightings of cells, by any key; `on_presence` takes in a report of one."""

    def __init__(self, sensor_offsets_m: Sequence[tuple[float, float]]) -> None:
        self._offsets_m = np.array(sensor_offsets_m, np.float64)
        self._full = (1 << len(sensor_offsets_m)) - 1
        self._centres: dict[int, Floats] = {}
        self._between: dict[tuple[int, int], Floats] = {}
        self._sights: dict[tuple[int, int], int] = {}

    @property
    def seen(self) -> set[int]:
        """The cells that another has seen the plate together with."""
        return {key for pair in self._sights for key in pair}

    def on_presence(self, key: int, bits: int) -> None:
        """Take in the presence bits of a cell."""
        self._centres.pop(key, None)
        if bits & self._full:
            covered = [bool(bits >> sensor & 1) for sensor in range(len(self._offsets_m))]
            self._centres[key] = self._offsets_m[covered].mean(axis=0)
        for first, second in combinations(sorted(self._centres), 2):
            towards = self._centres[first] - self._centres[second]
            if towards.any():
                pair = (first, second)
                self._between[pair] = self._between.get(pair, np.zeros(2)) + towards
                self._sights[pair] = self._sights.get(pair, 0) + 1

    def grid(self) -> dict[int, Spot]:
        """Column and row of each cell that hangs together with most, the lowest of each being 1.

        Raises SightingError where two cells fall on one place, or a pair was seen the other way.
        """
        places = self._placed()
        taken: dict[Spot, int] = {}
        for key, spot in places.items():
            if spot in taken:
                raise SightingError(f"{_pair(taken[spot], key)} fall on one place; {_ADVICE}")
            taken[spot] = key
        self._check(places)
        left, low = (min((spot[side] for spot in places.values()), default=0) for side in (0, 1))
        return {key: (x - left + 1, y - low + 1) for key, (x, y) in places.items()}

    def _placed(self) -> dict[int, Spot]:
        """Cells one step from each other along the pairs that were seen most, from one of them on.

        A cell and the one after the next are seen together less often than either with the one
        between, so that steps are between neighbours.
        """
        pairs = sorted(self._certain(), key=lambda pair: -self._sights[pair])
        places: dict[int, Spot] = {}
        groups: dict[int, dict[int, Spot]] = {}
        for pair in pairs:
            first, second = (groups.setdefault(key, {key: (0, 0)}) for key in pair)
            if first is second:
                continue
            step = _step(self._between[pair])
            at, other = first[pair[0]], second[pair[1]]
            shift = (at[0] + step[0] - other[0], at[1] + step[1] - other[1])
            for key, (x, y) in second.items():
                first[key] = (x + shift[0], y + shift[1])
                groups[key] = first
        for group in groups.values():
            places = max(places, group, key=len)
        return places

    def _certain(self) -> Iterator[tuple[int, int]]:
        return (pair for pair, sights in self._sights.items() if sights >= _SIGHTS_MIN)

    def _check(self, places: Mapping[int, Spot]) -> None:
        """Raises SightingError for a pair that lies the other way than it was seen."""
        for pair in self._certain():
            if not places.keys() >= {*pair}:
                continue
            (x_1, y_1), (x_2, y_2) = places[pair[0]], places[pair[1]]
            if np.dot(self._between[pair], (x_2 - x_1, y_2 - y_1)) <= 0.0:
                raise SightingError(f"{_pair(*pair)} contradict the others; {_ADVICE}")


_ADVICE = (
    "is one mounted the other way round, a sensor stuck, or something else on the table? "
    "Move one plate alone, smaller than two cells"
)


def _step(towards: Floats) -> Spot:
    """The neighbour in this direction: a step along x, along y, or both."""
    x, y = towards.tolist()
    along_x = 0 if abs(x) < _ALONG * abs(y) else int(np.sign(x))
    along_y = 0 if abs(y) < _ALONG * abs(x) else int(np.sign(y))
    return along_x, along_y


def _pair(first: int, second: int) -> str:
    return f"cells {first:08X} and {second:08X}"
