"""Whether a layout is well-formed, so that there is a plan for it.

It is when there is an order in which each parcel has a way past the tiles under the goals of those
before it and the starts of those after it: planned in this order each finds a route, for at worst
it waits until those before it have come to their goals.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import NamedTuple

import numpy as np

from mdms_host.routes.errand import Errand
from mdms_host.routes.intervals.way_alone import WayAlone
from mdms_model.arrays import Bools

#: A way of a parcel alone past blocked tiles.
WayPast = Callable[[Errand, Bools], WayAlone]

#: Orders are begun anew so often, and so many beginnings of one, for each parcel, are looked at.
_TRIES, _BEGINNINGS = 60, 2
_NONE = np.zeros(0, dtype=np.int64)


class Places(NamedTuple):
    """Parcels at their goals, and others at their starts."""

    at_goals: frozenset[str]
    at_starts: frozenset[str]

    def without(self, parcel: str) -> "Places":
        """The places of all others."""
        return Places(self.at_goals - {parcel}, self.at_starts - {parcel})

    def all_in(self, other: "Places") -> bool:
        """Whether these are all among others."""
        return self.at_goals <= other.at_goals and self.at_starts <= other.at_starts

    def none_in(self, other: "Places") -> bool:
        """Whether none of these is among others."""
        return self.at_goals.isdisjoint(other.at_goals) and self.at_starts.isdisjoint(
            other.at_starts
        )


class Precedence:
    """Who must go before whom, of some parcels, and all that follows from it."""

    def __init__(self, names: Sequence[str]) -> None:
        self.before: dict[str, set[str]] = {name: set() for name in names}
        self.after: dict[str, set[str]] = {name: set() for name in names}

    def add(self, first: str, second: str) -> bool:
        """One must go before another; False: it must go after it as well."""
        firsts, seconds = {first, *self.before[first]}, {second, *self.after[second]}
        for name in firsts:
            self.after[name] |= seconds
        for name in seconds:
            self.before[name] |= firsts
        return firsts.isdisjoint(seconds)


class Orders:
    """A search for an order in which parcels with goals could go one after another.

    Depth first: who can go next is tried in the sequence that is given, and goes on from after who
    went before. What comes after some that have gone does not depend on the order they went in
    (R. Wang, K. Gao, D. Nakhimovich, J. Yu, K. Bekris, 2021), and is in vain where one that is left
    has no way past their goals even if it were alone. Of ways that were found is kept whose places
    they meet, and of parcels who barred them from any: most questions are answered by that.
    """

    def __init__(self, errands: Mapping[str, Errand], closed: Bools, way_past: WayPast) -> None:
        self._errands = errands
        self._way_past = way_past
        self._moving = [name for name, each in errands.items() if each.task.goal is not None]
        self._closed = closed
        self._standing = np.zeros_like(closed)
        for errand in errands.values():
            if errand.task.goal is None:
                self._standing[errand.stand] = True
        #: Whose goal and whose start each tile is under, (tiles, 2, moving).
        self._under = np.zeros((len(closed), 2, len(self._moving)), dtype=bool)
        for index, name in enumerate(self._moving):
            self._under[errands[name].goal_stand, 0, index] = True
            self._under[errands[name].stand, 1, index] = True
        self._ways: dict[str, list[Places]] = {name: [] for name in self._moving}
        self._bars: dict[str, list[Places]] = {name: [] for name in self._moving}
        self._in_vain: set[frozenset[str]] = set()
        self._left = 0

    def first(self) -> tuple[str, ...] | None:
        """The first order that is found, as given if that does; None: none was found."""
        moving, random = list(self._moving), Random("orders")
        for _ in range(_TRIES):
            self._left = _BEGINNINGS * len(moving)
            order = self._from((), moving)
            if order is not None:
                return order
            if self._left > 0:
                return None
            moving = random.sample(moving, len(moving))
        return None

    def _from(self, gone: tuple[str, ...], rest: Sequence[str]) -> tuple[str, ...] | None:
        """An order that begins so."""
        if not rest:
            return gone
        at_goals = frozenset(gone)
        if at_goals in self._in_vain or not all(
            self._has_way(name, at_goals, frozenset()) for name in rest
        ):
            return None
        self._left -= 1
        untried, bars = list(rest), -1
        while untried:
            if bars != (bars := sum(len(self._bars[name]) for name in rest)):
                precedence = self._precedence(at_goals, rest)
                harm = self._harm(at_goals, rest)
            if precedence is None or self._left <= 0:
                break
            name = min(untried, key=harm.__getitem__)
            untried.remove(name)
            index = rest.index(name)
            others = [*rest[index + 1 :], *rest[:index]]
            if precedence.before[name] or not self._has_way(name, at_goals, frozenset(others)):
                continue
            order = self._from((*gone, name), others)
            if order is not None:
                return order
            if not self._harm(at_goals, rest)[name]:
                break
        if self._left > 0:
            self._in_vain.add(at_goals)
        return None

    def _harm(self, at_goals: frozenset[str], rest: Sequence[str]) -> Counter[str]:
        """How many known bars of the rest a parcel may be part of once it is at its goal."""
        harm: Counter[str] = Counter()
        for name in rest:
            for bar in self._bars[name]:
                if bar.at_starts.isdisjoint(at_goals):
                    harm.update(bar.at_goals)
        return harm

    def _precedence(self, at_goals: frozenset[str], rest: Sequence[str]) -> Precedence | None:
        """Who of the rest must go before whom, as far as is known; None: there is no such order.

        Of a bar one has to be elsewhere: where it can be only one any more, it must.
        """
        found, more = Precedence(rest), True
        while more:
            more = False
            for name in rest:
                before, after = found.before[name], found.after[name]
                for bar in self._bars[name]:
                    gone = not (
                        at_goals.isdisjoint(bar.at_starts) and before.isdisjoint(bar.at_starts)
                    )
                    if gone or not after.isdisjoint(bar.at_goals):
                        continue
                    later, sooner = bar.at_goals - at_goals - before, bar.at_starts - after
                    if len(later) + len(sooner) > 1:
                        continue
                    more = True
                    pairs = [
                        *((name, other) for other in later),
                        *((other, name) for other in sooner),
                    ]
                    if not pairs or not found.add(*pairs[0]):
                        return None
        return found

    def _has_way(self, name: str, at_goals: frozenset[str], at_starts: frozenset[str]) -> bool:
        """Whether a parcel has a way past some at their goals and others at their starts."""
        places = Places(at_goals, at_starts)
        if any(bar.all_in(places) for bar in self._bars[name]):
            return False
        bar = self._bar(name, places)
        if bar is None:
            return True
        # Without those who bar it in vain.
        for other in (*sorted(bar.at_goals), *sorted(bar.at_starts)):
            if other in bar.at_goals | bar.at_starts:
                bar = self._bar(name, bar.without(other)) or bar
        self._bars[name].append(bar)
        return False

    def _bar(self, name: str, places: Places) -> Places | None:
        """Those of these who bar a parcel from any way; None: it has one, which is kept."""
        if any(way.none_in(places) for way in self._ways[name]):
            return None
        blocked = self._closed.copy()
        blocked[self._errands[name].stand] = False
        blocked |= self._standing
        goals = [self._errands[other].goal_stand for other in places.at_goals]
        starts = [self._errands[other].stand for other in places.at_starts]
        blocked[np.concatenate([*goals, *starts, _NONE])] = True
        way = self._way_past(self._errands[name], blocked)
        met = Places(*(self._on(self._under[way.tiles, end]) for end in (0, 1)))
        if way.found:
            self._ways[name].append(met)
            return None
        return Places(met.at_goals & places.at_goals, met.at_starts & places.at_starts)

    def _on(self, under: Bools) -> frozenset[str]:
        """Those of whose places some of these tiles are, (tiles, moving)."""
        return frozenset(self._moving[index] for index in np.flatnonzero(under.any(axis=0)))
