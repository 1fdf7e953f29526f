"""Whether a layout is well-formed, so that there is a plan for it.

It is when there is an order in which each parcel has a way past the tiles under the goals of those
before it and the starts of those after it: planned in this order each finds a route, for at worst
it waits until those before it have come to their goals.
"""

from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import NamedTuple

import numpy as np

from mdms_host.routes.errand import Errand
from mdms_host.routes.intervals.way_alone import WayAlone
from mdms_model.arrays import Bools, Ints

#: A way of a parcel alone past blocked tiles.
WayPast = Callable[[Errand, Bools], WayAlone]

#: Orders are begun anew so often, and so many beginnings of one, for each parcel, are looked at.
_TRIES, _BEGINNINGS = 60, 2


class Bar(NamedTuple):
    """A parcel has no way while all of some are at their goals, and all of others at starts."""

    at_goals: frozenset[str]
    at_starts: frozenset[str]


class Orders:
    """A search for an order in which parcels with goals could go one after another.

    Depth first: who can go next is tried in the sequence that is given, and goes on from after who
    went before. What comes after some that have gone does not depend on the order they went in
    (R. Wang, K. Gao, D. Nakhimovich, J. Yu, K. Bekris, 2021), and is in vain where one that is left
    has no way past their goals even if it were alone. Ways that were found, and by whom one was
    barred from any, are kept: most questions are answered by them.
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
        self._ways: dict[str, list[Ints]] = {name: [] for name in self._moving}
        self._bars: dict[str, list[Bar]] = {name: [] for name in self._moving}
        self._in_vain: set[frozenset[str]] = set()
        #: The tiles of those who were last asked about: often the same for all.
        self._taken_by: tuple[frozenset[str], frozenset[str]] = frozenset(), frozenset()
        self._taken = self._standing.copy()
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
        untried = list(rest)
        while untried:
            # By what has been found out since.
            before = self._must_go_before(at_goals, rest)
            if before is None or self._left <= 0:
                break
            name = min(untried, key=lambda each: self._harm(each, at_goals, rest))
            untried.remove(name)
            index = rest.index(name)
            others = [*rest[index + 1 :], *rest[:index]]
            if before[name] or not self._has_way(name, at_goals, frozenset(others)):
                continue
            order = self._from((*gone, name), others)
            if order is not None:
                return order
            if not self._harm(name, at_goals, rest):
                break
        if self._left > 0:
            self._in_vain.add(at_goals)
        return None

    def _harm(self, name: str, at_goals: frozenset[str], rest: Sequence[str]) -> int:
        """How many known bars of the rest a parcel may be part of once it is at its goal."""
        return sum(
            name in bar.at_goals and not bar.at_starts & at_goals
            for other in rest
            for bar in self._bars[other]
        )

    def _must_go_before(
        self, at_goals: frozenset[str], rest: Sequence[str]
    ) -> dict[str, set[str]] | None:
        """Who of the rest must go before each, as far as is known; None: there is no such order.

        Of a bar one has to be elsewhere: where it can be only one any more, it must.
        """
        before: dict[str, set[str]] = {name: set() for name in rest}
        pairs = -1
        while pairs != (pairs := sum(map(len, before.values()))):
            for name in rest:
                after = {other for other in rest if name in before[other]}
                gone = at_goals | before[name]
                for bar in self._bars[name]:
                    if bar.at_goals & after or bar.at_starts & gone:
                        continue
                    later, sooner = bar.at_goals - gone, bar.at_starts - after
                    if not later and not sooner:
                        return None
                    if len(later) + len(sooner) == 1:
                        before[name] |= sooner
                        for other in later:
                            before[other].add(name)
            for name in rest:
                before[name] = before[name].union(*(before[other] for other in before[name]))
                if name in before[name]:
                    return None
        return before

    def _is_barred(self, name: str, at_goals: frozenset[str], at_starts: frozenset[str]) -> bool:
        """Whether it is known that a parcel has no way past these."""
        return any(
            bar.at_goals <= at_goals and bar.at_starts <= at_starts for bar in self._bars[name]
        )

    def _has_way(self, name: str, at_goals: frozenset[str], at_starts: frozenset[str]) -> bool:
        """Whether a parcel has a way past some at their goals and others at their starts."""
        if self._is_barred(name, at_goals, at_starts):
            return False
        blocked = self._blocked(name, at_goals, at_starts)
        if any(not blocked[way].any() for way in self._ways[name]):
            return True
        stops = self._stops(name, at_goals, at_starts)
        if stops is not None:
            self._bars[name].append(self._bar(name, stops))
        return stops is None

    def _bar(self, name: str, bar: Bar) -> Bar:
        """The same without those who bar a parcel in vain."""
        for other in sorted(bar.at_goals):
            bar = self._stops(name, bar.at_goals - {other}, bar.at_starts) or bar
        for other in sorted(bar.at_starts):
            bar = self._stops(name, bar.at_goals, bar.at_starts - {other}) or bar
        return bar

    def _stops(self, name: str, at_goals: frozenset[str], at_starts: frozenset[str]) -> Bar | None:
        """Those of these who bar a parcel from any way; None: it has one, which is kept."""
        way = self._way_past(self._errands[name], self._blocked(name, at_goals, at_starts))
        if way.found:
            self._ways[name].append(way.tiles)
            return None
        stops = np.zeros_like(self._closed)
        stops[way.tiles] = True
        return Bar(
            frozenset(other for other in at_goals if stops[self._errands[other].goal_stand].any()),
            frozenset(other for other in at_starts if stops[self._errands[other].stand].any()),
        )

    def _blocked(self, name: str, at_goals: frozenset[str], at_starts: frozenset[str]) -> Bools:
        """The tiles that a parcel has to keep off; what is closed under it does not count."""
        blocked = self._closed.copy()
        blocked[self._errands[name].stand] = False
        if (at_goals, at_starts) != self._taken_by:
            self._taken_by = at_goals, at_starts
            self._taken = self._standing.copy()
            for other in at_goals:
                self._taken[self._errands[other].goal_stand] = True
            for other in at_starts:
                self._taken[self._errands[other].stand] = True
        blocked |= self._taken
        return blocked
