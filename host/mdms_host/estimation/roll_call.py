"""Assignment of the parcels that are looked for to groups of sensors.

The cost of a pair is the number of sensors that contradict it, and the way from the expected place.
Parcels go to groups at the least total. A search takes some milliseconds, so each step makes one.
Only those pairs are tried that the costs so far would choose, since an untried pair costs least.

Two parcels that touch cover one group of sensors. They are told apart where that is no guess: all
places of either outline that cover no free sensor are tried. Two places explain the group if each
of its sensors is under one of them, and none under both.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import hypot

import numpy as np

from mdms_host.estimation.footprint import Footprint
from mdms_host.estimation.locating import Location, Search
from mdms_host.estimation.parcel import BoundingBox
from mdms_host.estimation.presence import Surroundings
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats, Ints


def assign(cost: Floats) -> Ints:
    """The column of each row, all different, for which the sum of `cost` (R, C) is least, (R,).

    Needs finite costs, and no fewer columns than rows. Takes R^2 steps of C.
    """
    rows, columns = cost.shape
    # Column 0 is where a row that is not assigned yet stands; potentials are of rows and columns.
    row_of = np.zeros(columns + 1, dtype=np.int64)
    rows_m, columns_m = np.zeros(rows + 1), np.zeros(columns + 1)
    for row in range(1, rows + 1):
        row_of[0] = row
        here, before = 0, np.zeros(columns + 1, dtype=np.int64)
        shortest, reached = np.full(columns + 1, np.inf), np.zeros(columns + 1, dtype=bool)
        while row_of[here]:
            reached[here] = True
            from_row = row_of[here]
            reduced = cost[from_row - 1] - rows_m[from_row] - columns_m[1:]
            nearer = ~reached[1:] & (reduced < shortest[1:])
            shortest[1:][nearer] = reduced[nearer]
            before[1:][nearer] = here
            open_ = np.where(reached[1:], np.inf, shortest[1:])
            here = int(open_.argmin()) + 1
            step = open_[here - 1]
            rows_m[row_of[reached]] += step
            columns_m[reached] -= step
            shortest[1:][~reached[1:]] -= step
        while here:
            row_of[here] = row_of[before[here]]
            here = int(before[here])
    column_of = np.zeros(rows, dtype=np.int64)
    for column in range(1, columns + 1):
        if row_of[column]:
            column_of[row_of[column] - 1] = column - 1
    return column_of


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
    one: Footprint, other: Footprint, covered_m: Floats, free_m: Floats
) -> Iterator[tuple[Bools, Bools] | None]:
    """Which of the covered sensors (C, 2) are surely under one, and under the other, (C,) each.

    `free_m` (F, 2) are the free sensors around. Yields None step by step, and both at last, if one
    way to divide the group is much likelier than any other. Of two that look the same it is
    arbitrary which is the first.
    """
    alike = one == other
    places: list[list[_Places]] = []
    for footprint in (one,) if alike else (one, other):
        places.append([])
        for some in _all_places(footprint, covered_m, free_m):
            places[-1].extend(some)
            yield None
    if alike:
        places *= 2
    most = [max((each.counts.max() for each in found), default=0.0) for found in places]
    sets = []
    for found, footprint, others in zip(places, (one, other), reversed(most), strict=True):
        # Sensors that the other cannot cover must be under this one.
        yield None
        sets.append(_sets(footprint, found, len(covered_m) - others - _SPARE, len(covered_m)))
    yield _likely(sets[0], sets[1], covered_m, alike=alike)


def _all_places(footprint: Footprint, covered_m: Floats, free_m: Floats) -> Iterator[list[_Places]]:
    """All places that cover no free sensor, some yaws at a time."""
    yaws_rad = footprint.yaws_rad(0.0, _YAW_STEP_RAD)
    for first in range(0, len(yaws_rad), _YAWS):
        some = (
            _at_yaw(footprint, yaw_rad, covered_m, free_m)
            for yaw_rad in yaws_rad[first : first + _YAWS].tolist()
        )
        yield [each for each in some if len(each.centres_m)]


def _at_yaw(footprint: Footprint, yaw_rad: float, covered_m: Floats, free_m: Floats) -> _Places:
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    own_m, own_free_m = covered_m @ turn, free_m @ turn
    along_m, across_m = (
        np.arange(own_m[:, axis].min(), own_m[:, axis].max() + _STEP_M, _STEP_M) for axis in (0, 1)
    )
    free = footprint.hidden(own_free_m, np.ones(len(own_free_m)), along_m, across_m)
    counts = footprint.hidden(own_m, np.ones(len(own_m)), along_m, across_m)
    rows, columns = np.nonzero(free == 0)
    centres_m = np.column_stack((along_m[rows], across_m[columns]))
    return _Places(own_m, centres_m, counts[rows, columns])


def _sets(
    footprint: Footprint, places: list[_Places], least: float, sensors: int
) -> tuple[Floats, Floats]:
    """Which sensors (C,) places with so many cover, all different, (N, C); how many do, (N,)."""
    masks = []
    for each in places:
        centres_m = each.centres_m[each.counts >= max(least, _LEAST)]
        if len(centres_m):
            away_m = (each.own_m[None, :, :] - centres_m[:, None, :]).reshape(-1, 2)
            inside = footprint.distance_m(away_m, np.zeros(3)) < 0
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


#: A parcel is taken to be this far from where it is expected rather than to contradict one sensor
#: more [m], and no way counts for more than so many sensors.
_WAY_M = 0.2
_MOST_WAY = 4.0
#: A parcel that is to come is found in the place of a doubtful one where this contradicts so many
#: sensors more.
_COMING = 2.0
#: Bonus of each sensor that is explained.
_EXPLAINED = 0.1
#: Not to be found at all costs more than any place.
_ABSENT = 1000.0
_IMPOSSIBLE = 1e6
#: Two expected outlines divide a group if both are no farther from its sensors than this [m].
_EXPECTED_M = 0.1
#: So many pairs of outlines are tried on a group that no parcel explains alone.
_PAIRS = 10

Key = tuple[Footprint, float, bytes]


@dataclass(frozen=True, slots=True)
class Sought:
    """A parcel that is looked for: its outline, the pose it is expected at, and where it may be."""

    name: str
    footprint: Footprint
    yaw_hint_rad: float
    place: Floats | None = None
    region: BoundingBox | None = None

    def may_be_in(self, places_m: Floats) -> bool:
        """Whether its middle may be at any of these places (N, 2)."""
        return self.region is None or bool(self.region.holds(places_m).any())


@dataclass(frozen=True, slots=True)
class Found:
    """Where a parcel has been found, by which sensors, and without which that contradict (S,)."""

    name: str
    location: Location
    group: Ints
    left_out: Bools


@dataclass(frozen=True, slots=True)
class SensorScene:
    """State of the sensors, (S,) each, and the groups of those that no found parcel covers.

    `taken` (S,) are for sure under parcels that are found, and `disputed` (S,) around the last
    places of doubtful ones.
    """

    covered: Bools
    valid: Bools
    groups: tuple[Ints, ...]
    taken: Bools
    disputed: Bools


class RollCall:
    """Looks for parcels, one search a step.

    `settled` is whether everything has been tried, with `absent` the names of parcels that are not
    there. `heaps` are groups, as bytes, that more than one of the sought parcels must cover, and
    that cannot be told apart.
    """

    def __init__(self, layout: Layout, surroundings: Surroundings) -> None:
        self.settled = True
        self.absent: frozenset[str] = frozenset()
        self._layout = layout
        self._surroundings = surroundings
        self._sensors_m = layout.sensors_m
        self._searches: dict[Key, Search] = {}
        self._divisions: dict[bytes, _Division] = {}
        self._spreads: dict[bytes, tuple[Floats, float]] = {}

    @property
    def heaps(self) -> set[bytes]:
        """Groups of covered sensors that are several parcels, as bytes."""
        return {key for key, division in self._divisions.items() if division.is_heap}

    def step(self, sought: Sequence[Sought], scene: SensorScene) -> list[Found]:
        """Try once more; the parcels that are found, once their assignment is sure."""
        self._keep(scene.groups)
        parts = [part for group in scene.groups for part in self._parts(group)]
        pairs = self._assigned(sought, parts, scene.disputed)
        self.settled = False
        for one, part in pairs:
            search = self._search(one, part, scene)
            if not search.over:
                search.step()
                return []
        return self._conclude(sought, scene, pairs)

    def _keep(self, groups: Iterable[Ints]) -> None:
        """Of groups that are not there any more nothing is kept."""
        there = {group.tobytes() for group in groups}
        self._divisions = {key: each for key, each in self._divisions.items() if key in there}
        parts = there.union(
            part.tobytes() for division in self._divisions.values() for part in division.parts
        )
        self._searches = {key: each for key, each in self._searches.items() if key[2] in parts}
        self._spreads = {key: each for key, each in self._spreads.items() if key in parts}

    def _parts(self, group: Ints) -> tuple[Ints, ...]:
        division = self._divisions.get(group.tobytes())
        return division.parts if division else (group,)

    def _assigned(
        self, sought: Sequence[Sought], groups: Sequence[Ints], disputed: Bools
    ) -> list[tuple[Sought, Ints]]:
        """The assignment of parcels to groups by the costs so far."""
        if not sought or not groups:
            return []
        # The parcel that was given first is looked for first.
        cost = np.full((len(sought), len(groups) + len(sought)), _ABSENT)
        cost -= 1e-3 * np.arange(len(sought))[:, None]
        for row, one in enumerate(sought):
            for column, group in enumerate(groups):
                cost[row, column] = self._cost(one, group)
                if one.region is not None and disputed[group].any():
                    cost[row, column] += _COMING
        columns = assign(cost)
        return [
            (sought[row], groups[column])
            for row, column in enumerate(columns.tolist())
            if column < len(groups) and cost[row, column] < _ABSENT / 2
        ]

    def _cost(self, one: Sought, group: Ints) -> float:
        """The least contradiction if a parcel covers a group, counted in sensors."""
        middle_m, extent_m = self._spread(group)
        # One cell may be left out.
        most_m = 2 * one.footprint.reach_m + 1.5 * self._layout.pitch_m
        if extent_m > most_m or not one.may_be_in(middle_m[None]):
            return _IMPOSSIBLE
        cost = -_EXPLAINED * len(group)
        if one.place is not None:
            cost += min(hypot(*(middle_m - one.place[:2]).tolist()) / _WAY_M, _MOST_WAY)
        search = self._searches.get(_key(one, group))
        if search is None or not search.tried:
            return cost
        if search.found is None:
            return _IMPOSSIBLE if search.over else cost + len(group)
        return cost + search.found.contradictions

    def _spread(self, group: Ints) -> tuple[Floats, float]:
        """The middle of a group, and the greatest distance between any two of its sensors [m]."""
        key = group.tobytes()
        if key not in self._spreads:
            covered_m = self._sensors_m[group]
            middle_m = (covered_m.min(axis=0) + covered_m.max(axis=0)) / 2
            self._spreads[key] = middle_m, _extent_m(covered_m)
        return self._spreads[key]

    def _search(self, one: Sought, group: Ints, scene: SensorScene) -> Search:
        key = _key(one, group)
        if key not in self._searches:
            mine = np.zeros(len(scene.covered), dtype=bool)
            near = self._near(one, group)
            # Where another is, this one is not.
            covered = scene.covered & ~scene.taken
            covered[group] = True
            mine[near] = scene.valid[near] & ~covered[near]
            mine[group] = True
            self._searches[key] = Search(
                one.footprint, self._layout, covered, mine, one.yaw_hint_rad
            )
        return self._searches[key]

    def _near(self, one: Sought, group: Ints) -> Ints:
        """All sensors that may show whether a parcel covers a group."""
        middle_m, _ = self._spread(group)
        return self._surroundings.of(middle_m, 2 * one.footprint.reach_m).sensors

    def _conclude(
        self, sought: Sequence[Sought], scene: SensorScene, pairs: Sequence[tuple[Sought, Ints]]
    ) -> list[Found]:
        """All pairs have been tried: start from them, and divide groups that nothing explains."""
        placed = {part.tobytes() for _, part in pairs}
        names = {one.name for one, _ in pairs}
        absent = [one for one in sought if one.name not in names]
        self.settled = True
        complete: set[bytes] = set()
        for group in scene.groups:
            parts = {part.tobytes() for part in self._parts(group)}
            if parts <= placed:
                complete |= parts
            elif self.settled:
                self.settled = not self._divide(group, sought, scene)
        self.absent = frozenset(one.name for one in absent)
        return [
            Found(one.name, search.found, part, search.left_out)
            for one, part in pairs
            if part.tobytes() in complete
            and (search := self._search(one, part, scene)).found is not None
        ]

    def _divide(self, group: Ints, sought: Sequence[Sought], scene: SensorScene) -> bool:
        """Divide a group in the next way there is; False if there is none."""
        there = [one for one in sought if one.may_be_in(self._sensors_m[group])]
        names = frozenset(one.name for one in there)
        division = self._divisions.get(group.tobytes())
        if len(there) < 2:
            return self._divisions.pop(group.tobytes(), None) is not None
        if division is None or division.names != names:
            _, extent_m = self._spread(group)
            large = all(extent_m > 2 * one.footprint.reach_m for one in there)
            division = _Division(group, names, self._ways(group, there, scene), large)
            self._divisions[group.tobytes()] = division
        return division.next()

    def _ways(
        self, group: Ints, sought: Sequence[Sought], scene: SensorScene
    ) -> Iterator[tuple[Ints, ...]]:
        """Ways to divide a group: by where parcels are expected, then by what explains it."""
        covered_m = self._sensors_m[group]
        away_m = [
            one.footprint.distance_m(covered_m, one.place)
            for one in sought
            if one.place is not None
        ]
        away_m = [each for each in away_m if each.min() < _EXPECTED_M]
        if len(away_m) > 1:
            nearest = np.argmin(away_m, axis=0)
            yield tuple(group[nearest == number] for number in np.unique(nearest).tolist())
        for one, other in list(combinations(sought, 2))[:_PAIRS]:
            near = np.union1d(self._near(one, group), self._near(other, group))
            free_m = self._sensors_m[near[scene.valid[near] & ~scene.covered[near]]]
            for told in tell_apart(one.footprint, other.footprint, covered_m, free_m):
                yield () if told is None else (group[told[0]], group[told[1]])


class _Division:
    """The ways to divide one group, tried one after the other; `parts` are those of now.

    A `large` group that no way explains is a heap.
    """

    def __init__(
        self, group: Ints, names: frozenset[str], ways: Iterator[tuple[Ints, ...]], large: bool
    ) -> None:
        self.names = names
        self.parts: tuple[Ints, ...] = (group,)
        self.is_heap = False
        self._group = group
        self._ways = ways
        self._large = large

    def next(self) -> bool:
        """Go on to the next way; False if there is none."""
        self.parts = (self._group,)
        way = next(self._ways, None)
        if way is None:
            self.is_heap = self._large
        elif len(way) > 1:
            self.parts = way
        return way is not None


def _key(one: Sought, group: Ints) -> Key:
    return one.footprint, one.yaw_hint_rad, group.tobytes()


def _extent_m(points_m: Floats) -> float:
    """The greatest distance between any two points [m]."""
    away_m = points_m[:, None, :] - points_m
    return float(np.sqrt((away_m**2).sum(axis=2).max()))
