"""How long a parcel alone would take to its goal from every node: what guides the search."""

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from mdms_host.routes.space.lattice import STRAIGHTS
from mdms_host.routes.space.roadmap import Graph
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
