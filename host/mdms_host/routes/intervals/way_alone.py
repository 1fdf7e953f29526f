"""A way of a parcel alone past places that others take for all time, of any cost."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mdms_host.routes.space.roadmap import Graph
from mdms_model.arrays import Bools, Ints
from mdms_model.compiled import compiled

#: Places in one word of a set of them.
_BITS = 62
#: The first bit of the first word: a tile that is closed.
_CLOSED = 1


class Steps(NamedTuple):
    """Single moves from every node, and the places that each meets, by bits of words.

    Of the lattice's moves those of one step are enough, since longer ones meet the same tiles.
    """

    first: Ints
    """The first step from each node, and their number, (nodes + 1,)."""
    end: Ints
    """Which node a step leads to, (S,)."""
    met: Ints
    """(S, words)."""


class WayAlone(NamedTuple):
    """Whether there is a way, and the places that it meets, as bits.

    Where there is none they are some of those that were not to be met, which leave none.
    """

    found: bool
    met: int


@dataclass(frozen=True)
class Alone:
    """All ways of a parcel between two nodes, those of the fewest steps first."""

    steps: Steps
    ends: tuple[int, int]

    def past(self, places: int) -> WayAlone:
        """A way that meets none of these places, which are bits, and nothing that is closed."""
        words, taken = range(self.steps.met.shape[1]), places << 1 | _CLOSED
        own = np.array([taken >> _BITS * word & (1 << _BITS) - 1 for word in words])
        found, met = way_past(self.steps, own, self.ends)
        bits = sum(bits << _BITS * word for word, bits in enumerate(met.tolist()))
        return WayAlone(found, bits >> 1)


def places_under(tiles: int, places: Sequence[Ints]) -> Ints:
    """On which of these places, given by their tiles, each tile is, by bits, (tiles, words)."""
    under = np.zeros((tiles, len(places) // _BITS + 1), dtype=np.int64)
    for bit, own in enumerate(places, start=1):
        under[own, bit // _BITS] |= 1 << bit % _BITS
    return under


def with_closed(under: Ints, closed: Bools) -> Ints:
    """The same with closed tiles."""
    both = under.copy()
    both[closed, 0] |= _CLOSED
    return both


@compiled
def steps_of(graph: Graph, open_lines: Bools, under: Ints) -> Steps:
    """The steps of a graph, by what each tile is under."""
    joins, moves, bases = graph.joins, graph.moves, graph.bases
    nodes, words = joins.first.size - 1, under.shape[1]
    most = joins.start.size + open_lines.sum()
    first, end = np.zeros(nodes + 1, np.int64), np.empty(most, np.int64)
    met = np.zeros((most, words), np.int64)
    stands = stands_met(graph, under)
    count = 0
    for node in range(nodes):
        for index in range(joins.first[node], joins.first[node + 1]):
            join = joins.onward[index]
            end[count] = joins.end[join]
            met[count, 0] = _CLOSED if joins.tips[join] else 0
            for visit in range(joins.met.first[join], joins.met.first[join + 1]):
                for word in range(words):
                    met[count, word] |= under[joins.met.tile[visit], word]
            count += 1
        for line in range(len(open_lines) if node < bases.size else 0):
            kind = moves.unit[node // graph.places, line]
            if kind < 0 or not open_lines[line, node]:
                continue
            end[count] = node + moves.far[kind]
            for word in range(words):
                met[count, word] = stands[end[count], word]
            for index in range(moves.beyond[kind], moves.beyond[kind + 1]):
                for word in range(words):
                    met[count, word] |= under[bases[node] + moves.beyond_tile[index], word]
            count += 1
        first[node + 1] = count
    return Steps(first, end[:count], met[:count])


@compiled
def stands_met(graph: Graph, under: Ints) -> Ints:
    """The places under a parcel at each node of the lattice; none off the table."""
    bases, tiles = graph.bases, graph.stand_tile
    stands = np.zeros((bases.size, under.shape[1]), np.int64)
    for yaw in range(bases.size // graph.places):
        first, last = graph.stand[yaw], graph.stand[yaw + 1]
        low, high = tiles[first:last].min(), tiles[first:last].max()
        for node in range(yaw * graph.places, (yaw + 1) * graph.places):
            if bases[node] + low < 0 or bases[node] + high >= len(under):
                continue
            for index in range(first, last):
                for word in range(under.shape[1]):
                    stands[node, word] |= under[bases[node] + tiles[index], word]
    return stands


@compiled
def way_past(steps: Steps, taken: Ints, ends: tuple[int, int]) -> tuple[bool, Ints]:
    """The result of `Alone.past`, for words of bits."""
    start, goal = ends
    # By which step each node was come to, and from which node; -1: it was not.
    by, came = np.full(steps.first.size - 1, -1), np.full(steps.first.size - 1, -1)
    came[start] = start
    queue, count, gone_on = np.full(came.size, start), 1, 0
    while gone_on < count and came[goal] < 0:
        node = queue[gone_on]
        gone_on += 1
        for step in range(steps.first[node], steps.first[node + 1]):
            there = steps.end[step]
            if came[there] < 0 and first_met(steps.met, step, taken) < 0:
                came[there], by[there] = node, step
                queue[count] = there
                count += 1
    if came[goal] < 0:
        return False, bar(steps, came, taken)
    met, node = np.zeros_like(taken), goal
    while node != start:
        met |= steps.met[by[node]]
        node = came[node]
    return True, met


@compiled
def bar(steps: Steps, came: Ints, taken: Ints) -> Ints:
    """Some of the taken places that bar every step from the reached nodes to any other."""
    some = np.zeros_like(taken)
    some[0] = _CLOSED
    for node in range(came.size):
        for step in range(steps.first[node], steps.first[node + 1]):
            leads_on = came[node] >= 0 and came[steps.end[step]] < 0
            if leads_on and first_met(steps.met, step, some) < 0:
                word = first_met(steps.met, step, taken)
                bits = steps.met[step, word] & taken[word]
                some[word] |= bits & -bits
    return some


@compiled
def first_met(met: Ints, step: int, taken: Ints) -> int:
    """The first word in which a step meets a taken place; -1: there is none."""
    for word in range(taken.size):
        if met[step, word] & taken[word]:
            return word
    return -1
