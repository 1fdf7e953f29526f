"""The way of a parcel alone: its time from every node, and a way past places that others take.

The times guide the search."""

from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from mdms_host.routes.grid import STRAIGHTS
from mdms_host.routes.roadmap import Graph
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.compiled import compiled


class Guide(NamedTuple):
    """The parts of a graph that are open past tiles that are blocked for all time, with costs."""

    runs: Ints
    """How many steps each node may be left by along each line, (lines, nodes)."""
    barred: Bools
    """Which joins cross such a tile, or are left out, (J,)."""
    cost_s: Floats
    """Least time to the goal from each node [s], inf where no way is; waiting is never needed."""


@compiled
def cost_to_go(graph: Graph, runs: Ints, barred: Bools, goal: int) -> Floats:
    """`Guide.cost_s` by the rest of a guide (Dijkstra's algorithm from the goal)."""
    nodes = graph.joins.first.size - 1
    cost_s, done = np.full(nodes, np.inf), np.zeros(nodes, dtype=np.bool_)
    cost_s[goal] = 0.0
    heap = [(0.0, goal)]
    # A call with large tuples costs more than its work, so all is done within one.
    joins, moves, aligned = graph.joins, graph.moves, graph.aligned
    lattice, places = graph.bases.size, graph.places
    while len(heap) > 0:
        _, node = heappop(heap)
        if done[node]:
            continue
        done[node] = True
        for index in range(joins.back_first[node], joins.back_first[node + 1]):
            join = joins.back[index]
            start = joins.start[join]
            total_s = cost_s[node] + joins.duration_s[join]
            if not barred[join] and total_s < cost_s[start]:
                cost_s[start] = total_s
                heappush(heap, (total_s, start))
        if node >= lattice:
            continue
        # The lattice's nodes from which one move leads here.
        yaw = node // places
        last = moves.back_first[yaw + 1] if aligned[node] else moves.back_often[yaw]
        for index in range(moves.back_first[yaw], last):
            kind = moves.back[index]
            start = node - moves.far[kind]
            if start < 0 or start >= lattice:
                continue
            total_s = cost_s[node] + moves.duration_s[kind]
            if total_s >= cost_s[start] or runs[moves.line[kind], start] < moves.steps[kind]:
                continue
            # A start of another yaw has no such move, though its line is open to others.
            own = start // places
            if moves.first[own] <= kind < moves.first[own + 1]:
                cost_s[start] = total_s
                heappush(heap, (total_s, start))
    return cost_s


@compiled
def free_runs(graph: Graph, open_lines: Bools, blocked: Bools) -> Ints:
    """`Guide.runs` by the tiles that are blocked, along lines that are open without these."""
    moves, bases, places = graph.moves, graph.bases, graph.places
    lines, nodes = open_lines.shape
    is_free = free_stands(graph, blocked)
    runs = np.zeros((lines, nodes), dtype=np.int64)
    for line in range(lines):
        for yaw in range(nodes // places):
            kind = moves.unit[yaw, line]
            if kind < 0:
                continue
            far, straight = moves.far[kind], line < STRAIGHTS
            beyond = moves.beyond_tile[moves.beyond[kind] : moves.beyond[kind + 1]]
            for index in range(places):
                # The next place along the line comes before this one.
                place = places - 1 - index if far > 0 else index
                node = yaw * places + place
                if not open_lines[line, node] or not is_free[node] or not is_free[node + far]:
                    continue
                if first_blocked(beyond, bases[node], blocked) < 0:
                    runs[line, node] = 1 + runs[line, node + far] if straight else 1
    return runs


@compiled
def free_stands(graph: Graph, blocked: Bools) -> Bools:
    """At which nodes of the lattice a parcel is on no blocked tile; off the table: at none."""
    bases, places = graph.bases, graph.places
    is_free = np.zeros(bases.size, dtype=np.bool_)
    for yaw in range(bases.size // places):
        own = graph.stand_tile[graph.stand[yaw] : graph.stand[yaw + 1]]
        low, high = own.min(), own.max()
        for node in range(yaw * places, (yaw + 1) * places):
            base = bases[node]
            if base + low >= 0 and base + high < blocked.size:
                is_free[node] = first_blocked(own, base, blocked) < 0
    return is_free


@compiled
def barred_joins(graph: Graph, blocked: Bools) -> Bools:
    """`Guide.barred` by the tiles that are blocked."""
    joins = graph.joins
    barred = joins.tips.copy()
    for join in range(joins.start.size):
        tiles = joins.met.tile[joins.met.first[join] : joins.met.first[join + 1]]
        barred[join] |= first_blocked(tiles, 0, blocked) >= 0
    return barred


@compiled
def first_blocked(tiles: Ints, base: int, blocked: Bools) -> int:
    """The first of these tiles, numbered from a base, that is blocked; -1: none is."""
    for tile in tiles:
        if blocked[base + tile]:
            return int(base + tile)
    return -1


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
