"""Some way of a parcel alone past tiles that are blocked for all time, whatever it takes."""

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from mdms_host.routes.intervals.cost_to_go import first_blocked
from mdms_host.routes.space.roadmap import Graph
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.compiled import compiled

_NOT_LOOKED_FOR = -2


class WayAlone(NamedTuple):
    """Whether there is a way, and the tiles that it meets; some may come twice.

    Where there is none the tiles are blocked ones: those that one would have to be without.
    """

    found: bool
    tiles: Ints


@compiled
def way_alone(
    graph: Graph, open_lines: Bools, away_m: Floats, blocked: Bools, ends: tuple[int, int]
) -> WayAlone:
    """A way between two nodes past tiles that are blocked.

    Of the lattice's moves single steps are enough, since longer ones meet the same tiles. Nodes
    with the least `away_m` (nodes,) are gone on from first.
    """
    start, goal = ends
    joins, moves = graph.joins, graph.moves
    nodes = joins.first.size - 1
    # By which move each node was come to: a kind, a join as -1 - join, or none yet.
    none = moves.far.size
    came, by = np.full(nodes, -1, np.int64), np.full(nodes, none, np.int64)
    came[start] = start
    stops = np.zeros(blocked.size, dtype=np.bool_)
    # The first blocked tile under the parcel at each node, once that has been looked for.
    under = np.full(graph.bases.size, _NOT_LOOKED_FOR, np.int64)
    heap = [(0.0, start)]
    while len(heap) > 0 and came[goal] < 0:
        _, node = heappop(heap)
        for index in range(joins.first[node], joins.first[node + 1]):
            join = joins.onward[index]
            there = joins.end[join]
            met = joins.tile[joins.visit[join] : joins.visit[join + 1]]
            if came[there] >= 0 or joins.tips[join]:
                continue
            stop = first_blocked(met, 0, blocked)
            if stop >= 0:
                stops[stop] = True
            else:
                came[there], by[there] = node, -1 - join
                heappush(heap, (away_m[there], there))
        if node >= graph.bases.size:
            continue
        units = moves.unit[node // graph.places]
        for line in range(units.size):
            kind = units[line]
            if kind < 0 or not open_lines[line, node] or came[node + moves.far[kind]] >= 0:
                continue
            there = node + moves.far[kind]
            if under[there] == _NOT_LOOKED_FOR:
                turned = there // graph.places
                own = graph.stand_tile[graph.stand[turned] : graph.stand[turned + 1]]
                under[there] = first_blocked(own, graph.bases[there], blocked)
            stop = under[there]
            if stop < 0:
                beyond = moves.beyond_tile[moves.beyond[kind] : moves.beyond[kind + 1]]
                stop = first_blocked(beyond, graph.bases[node], blocked)
            if stop >= 0:
                stops[stop] = True
            else:
                came[there], by[there] = node, kind
                heappush(heap, (away_m[there], there))
    found = bool(came[goal] >= 0)
    met = tiles_to(graph, came, by, start, goal) if found else np.flatnonzero(stops)
    return WayAlone(found, met)


@compiled
def tiles_to(graph: Graph, came: Ints, by: Ints, start: int, goal: int) -> Ints:
    """The tiles of the way that was come by."""
    joins, moves = graph.joins, graph.moves
    parts = [np.zeros(0, np.int64)]
    node = goal
    while node != start:
        move, before = by[node], came[node]
        if move < 0:
            parts.append(joins.tile[joins.visit[-1 - move] : joins.visit[-move]])
        else:
            own = moves.tile[moves.visit[move] : moves.visit[move + 1]]
            parts.append(own + graph.bases[before])
        node = before
    count = 0
    for part in parts:
        count += part.size
    tiles, at = np.empty(count, np.int64), 0
    for part in parts:
        tiles[at : at + part.size] = part
        at += part.size
    return tiles
