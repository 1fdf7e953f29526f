"""Whether a layout is well-formed, so that there is a plan for it.

It is if there is an order in which each parcel has a way past the tiles under the goals of those
before it and the starts of those after it. Planned in this order each finds a route: at worst it
waits until those before it have come to their goals.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from random import Random

import numpy as np

from mdms_host.routes.attempt import is_free, ways_alone
from mdms_host.routes.planning_problem import PlanningProblem
from mdms_host.routes.ways_alone import places_under
from mdms_model.arrays import Bools

#: Orders are begun anew so often, and so many beginnings of one, for each parcel, are looked at.
_TRIES, _BEGINNINGS = 60, 2


class Precedence:
    """Known precedences between so many parcels, and all that follows from them, as bits."""

    def __init__(self, count: int) -> None:
        self.before, self.after = [0] * count, [0] * count

    def add(self, first: int, second: int) -> bool:
        """One must go before another; False: it must go after it as well."""
        firsts, seconds = 1 << first | self.before[first], 1 << second | self.after[second]
        for each in numbers(firsts):
            self.after[each] |= seconds
        for each in numbers(seconds):
            self.before[each] |= firsts
        return not firsts & seconds


class OrderSearch:
    """A search for an order in which parcels with goals could go one after another.

    It is depth first. The next parcel is tried in the given sequence, from after the parcel that
    went before. The rest of an order does not depend on the sequence of those that have gone (R.
    Wang, K. Gao, D. Nakhimovich, J. Yu, K. Bekris, 2021). It is in vain if a parcel that is left
    has no way past their goals, even alone. For each way that was found the places that it meets
    are kept. For each parcel without any the parcels that barred it are kept. Most questions are
    answered by these.

    Parcels are numbers, and some of them the bits of one. Of places those at goals are the lowest
    bits, and those at starts the next.
    """

    def __init__(self, problems: Mapping[str, PlanningProblem], closed: Bools) -> None:
        self._names = [name for name, each in problems.items() if each.task.goal is not None]
        moving = [problems[name] for name in self._names]
        standing = np.zeros_like(closed)
        for problem in problems.values():
            if problem.task.goal is None:
                standing[problem.stand] = True
        places = [problem.goal_stand for problem in moving] + [problem.stand for problem in moving]
        under, self._alone = places_under(len(closed), places), []
        for problem in moving:
            others = closed.copy()
            others[problem.stand] = False
            self._alone.append(ways_alone(problem, others | standing, under))
        self._ways: list[list[int]] = [[] for _ in moving]
        #: Of each bar the parcels that are part of it at their goals, and at their starts.
        self._bars: list[list[tuple[int, int]]] = [[] for _ in moving]
        self._in_vain: set[int] = set()
        self._left = 0

    def first(self) -> tuple[str, ...] | None:
        """The first order that is found, as given if that does; None: none was found."""
        moving, random = list(range(len(self._names))), Random("orders")
        for _ in range(_TRIES):
            self._left = _BEGINNINGS * len(moving)
            order = self._from((), moving)
            if order is not None:
                return tuple(self._names[each] for each in order)
            if self._left > 0:
                return None
            moving = random.sample(moving, len(moving))
        return None

    def _from(self, gone: tuple[int, ...], rest: Sequence[int]) -> tuple[int, ...] | None:
        """An order that begins so."""
        if not rest:
            return gone
        at_goals = bits(gone)
        if at_goals in self._in_vain or not all(self._has_way(each, at_goals, 0) for each in rest):
            return None
        self._left -= 1
        untried, bars = list(rest), -1
        while untried:
            if bars != (bars := sum(len(self._bars[each]) for each in rest)):
                precedence = self._precedence(at_goals, rest)
                harm = self._harm(at_goals, rest)
            if precedence is None or self._left <= 0:
                break
            each = min(untried, key=harm.__getitem__)
            untried.remove(each)
            index = rest.index(each)
            others = [*rest[index + 1 :], *rest[:index]]
            if precedence.before[each] or not self._has_way(each, at_goals, bits(others)):
                continue
            order = self._from((*gone, each), others)
            if order is not None:
                return order
            if not self._harm(at_goals, rest)[each]:
                break
        if self._left > 0:
            self._in_vain.add(at_goals)
        return None

    def _harm(self, at_goals: int, rest: Sequence[int]) -> Counter[int]:
        """How many known bars of the rest a parcel may be part of once it is at its goal."""
        harm: Counter[int] = Counter()
        for each in rest:
            for goals, starts in self._bars[each]:
                if not starts & at_goals:
                    harm.update(numbers(goals))
        return harm

    def _precedence(self, at_goals: int, rest: Sequence[int]) -> Precedence | None:
        """Known precedences between the rest of the parcels; None: there is no such order.

        Of each bar at least one parcel must be elsewhere. If only one still can be, it must.
        """
        found, more = Precedence(len(self._names)), True
        while more:
            more = False
            for each in rest:
                before, after = found.before[each], found.after[each]
                for goals, starts in self._bars[each]:
                    if (at_goals | before) & starts or after & goals:
                        continue
                    later, sooner = goals & ~at_goals & ~before, starts & ~after
                    if later.bit_count() + sooner.bit_count() > 1:
                        continue
                    more = True
                    pairs = [
                        *((each, other) for other in numbers(later)),
                        *((other, each) for other in numbers(sooner)),
                    ]
                    if not pairs or not found.add(*pairs[0]):
                        return None
        return found

    def _has_way(self, each: int, at_goals: int, at_starts: int) -> bool:
        """Whether a parcel has a way past some at their goals and others at their starts."""
        if any(not (g & ~at_goals or s & ~at_starts) for g, s in self._bars[each]):
            return False
        bar = self._bar(each, at_goals | at_starts << len(self._names))
        if bar is None:
            return True
        # Without parcels that bar it in vain.
        for other in numbers(bar):
            if bar >> other & 1:
                without = self._bar(each, bar & ~(1 << other))
                bar = bar if without is None else without
        self._bars[each].append((bar & (1 << len(self._names)) - 1, bar >> len(self._names)))
        return False

    def _bar(self, each: int, places: int) -> int | None:
        """Those of these places that bar a parcel from any way; None: it has one, which is kept."""
        if any(not way & places for way in self._ways[each]):
            return None
        way = self._alone[each].past(places)
        if way.found:
            self._ways[each].append(way.met)
            return None
        return way.met


def stuck(problems: Mapping[str, PlanningProblem], closed: Bools) -> list[str]:
    """The parcels that have no way to their goals even if all others with goals were gone."""
    standing = np.zeros_like(closed)
    for problem in problems.values():
        if problem.task.goal is None:
            standing[problem.stand] = True
    found = []
    for name, problem in problems.items():
        others = closed.copy()
        others[problem.stand] = False
        if problem.task.goal is not None and not is_free(problem, others | standing):
            found.append(name)
    return found


def bits(parcels: Sequence[int]) -> int:
    """Some parcels as bits."""
    return sum(1 << each for each in parcels)


def numbers(parcels: int) -> Iterator[int]:
    """Parcels that are given as bits, by number."""
    while parcels:
        yield (parcels & -parcels).bit_length() - 1
        parcels &= parcels - 1
