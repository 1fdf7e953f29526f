"""Safe-interval path planning: an early way of one parcel among those that have theirs.

First when each tile is taken, and from that when a pose or a move is free. Then the search, after
M. Phillips and M. Likhachev (ICRA 2011), for moves that take time and bodies that cover many tiles.
A state is a node and the safe interval in which the parcel stands there, reached as soon as it can
be. From it every move begins as soon as it can in each safe interval of its end. That time is
worked out only when the move's turn comes. The turn is by its cost without other parcels in its
way.
"""

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from mdms_host.routes.moves import Met
from mdms_host.routes.roadmap import Graph, Joins
from mdms_host.routes.ways_alone import Guide
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.compiled import compiled

#: A tile that is free up to an instant is left this much before. A tile that is free from an
#: instant on is entered this much after it [s].
INSTANT_S = 1e-9
_TILE_ROOM = 8


class Taken(NamedTuple):
    """When each tile is taken and by whom: the first `number` of each row, by their begin."""

    number: Ints
    last_s: Floats
    """When each tile is taken for the last time, (tiles,)."""
    from_s: Floats
    to_s: Floats
    owner: Ints


class TakenTiles:
    """The owners and times of each tile; `taken` has room for more as it fills."""

    def __init__(self, tiles: int) -> None:
        self.taken = _with_room(tiles, _TILE_ROOM)

    def take(self, owner: int, tiles: Ints, from_s: Floats, to_s: Floats) -> None:
        """An owner takes each of these tiles from an instant to another; a tile may come twice."""
        while not enter(self.taken, owner, tiles, from_s, to_s):
            old = self.taken
            self.taken = _with_room(len(old.number), 2 * old.from_s.shape[1])
            self.taken.number[:], self.taken.last_s[:] = old.number, old.last_s
            for new, former in zip(self.taken[2:], old[2:], strict=True):
                new[:, : former.shape[1]] = former

    def release(self, owner: int) -> None:
        """An owner takes nothing any more."""
        remove(self.taken, owner)


def _with_room(tiles: int, room: int) -> Taken:
    shape = tiles, room
    owners, numbers = np.zeros(shape, dtype=np.int64), np.zeros(tiles, dtype=np.int64)
    return Taken(numbers, np.full(tiles, -np.inf), np.zeros(shape), np.zeros(shape), owners)


@compiled
def enter(taken: Taken, owner: int, tiles: Ints, from_s: Floats, to_s: Floats) -> bool:
    """Enter intervals; False, and nothing of this owner is left, where there is no room for all."""
    for index, tile in enumerate(tiles):
        at = taken.number[tile]
        if at == taken.from_s.shape[1]:
            remove(taken, owner)
            return False
        while at > 0 and taken.from_s[tile, at - 1] > from_s[index]:
            copy(taken, tile, at - 1, at)
            at -= 1
        taken.from_s[tile, at], taken.to_s[tile, at] = from_s[index], to_s[index]
        taken.owner[tile, at] = owner
        taken.number[tile] += 1
        taken.last_s[tile] = max(taken.last_s[tile], to_s[index])
    return True


@compiled
def remove(taken: Taken, owner: int) -> None:
    """Remove all intervals of an owner."""
    for tile in range(taken.number.size):
        kept, last_s = 0, -np.inf
        for at in range(taken.number[tile]):
            if taken.owner[tile, at] != owner:
                copy(taken, tile, at, kept)
                kept, last_s = kept + 1, max(last_s, taken.to_s[tile, at])
        taken.number[tile], taken.last_s[tile] = kept, last_s


@compiled
def copy(taken: Taken, tile: int, at: int, to: int) -> None:
    """Copy one interval of a tile over another."""
    taken.from_s[tile, to], taken.to_s[tile, to] = taken.from_s[tile, at], taken.to_s[tile, at]
    taken.owner[tile, to] = taken.owner[tile, at]


@compiled
def first_departure(
    taken: Taken, met: Met, move: int, base: int, within_s: tuple[float, float]
) -> float:
    """The first instant at which one of these moves may begin so that its tiles are free [s].

    They are by their numbers less `base`. It begins from one instant up to another, `within_s`;
    inf: in none between.
    """
    first, end = met.first[move], met.first[move + 1]
    begin_s, settled, visit = within_s[0], 0, first
    while settled < end - first:
        place = base + met.tile[visit]
        settled += 1
        enter_s, leave_s = met.enters_s[visit], met.leaves_s[visit]
        visit = visit + 1 if visit + 1 < end else first
        if begin_s + enter_s >= taken.last_s[place]:
            continue
        for at in range(taken.number[place]):
            if begin_s + leave_s <= taken.from_s[place, at]:
                break
            free_s = taken.to_s[place, at]
            if begin_s + enter_s < free_s:
                begin_s = free_s - enter_s + INSTANT_S
                if begin_s > within_s[1]:
                    return np.inf
                settled = 0
    return begin_s if begin_s <= within_s[1] else np.inf


@compiled
def free_until(taken: Taken, base: int, tile: Ints, now_s: float) -> float:
    """Up to when tiles that are free now stay so [s]; -inf where one is taken."""
    until_s = np.inf
    for each in tile:
        place = base + each
        if taken.last_s[place] <= now_s + INSTANT_S:
            continue
        for at in range(taken.number[place]):
            if taken.to_s[place, at] > now_s + INSTANT_S:
                if taken.from_s[place, at] < now_s - INSTANT_S:
                    return -np.inf
                until_s = min(until_s, taken.from_s[place, at])
    return until_s


_ROOM = 1024


class States(NamedTuple):
    """By number of the state, in the order in which they were found; there is room for more."""

    node: Ints
    came: Ints
    """The state before it, -1 for the first."""
    by: Ints
    """The move that led to it."""
    next_of: Ints
    """Another state of the same node, -1 for none."""
    begun_s: Floats
    """When that move began."""
    at_s: Floats
    """When the node was reached, the soonest in its interval."""
    until_s: Floats
    """When its safe interval ends."""
    stale: Bools
    """Whether another reaches the same interval sooner."""


@compiled
def new_states() -> States:
    """Room for states."""
    return States(
        np.empty(_ROOM, np.int64),
        np.empty(_ROOM, np.int64),
        np.empty(_ROOM, np.int64),
        np.empty(_ROOM, np.int64),
        np.empty(_ROOM),
        np.empty(_ROOM),
        np.empty(_ROOM),
        np.empty(_ROOM, np.bool_),
    )


@compiled
def doubled(states: States) -> States:
    """The same with twice the room."""
    return States(
        np.concatenate((states.node, states.node)),
        np.concatenate((states.came, states.came)),
        np.concatenate((states.by, states.by)),
        np.concatenate((states.next_of, states.next_of)),
        np.concatenate((states.begun_s, states.begun_s)),
        np.concatenate((states.at_s, states.at_s)),
        np.concatenate((states.until_s, states.until_s)),
        np.concatenate((states.stale, states.stale)),
    )


class SearchState(NamedTuple):
    """One state, as `States` has it."""

    node: int
    came: int
    by: int
    begun_s: float
    at_s: float
    until_s: float


@compiled
def entered(states: States, head: Ints, number: int, state: SearchState) -> None:
    """Enter a state, which becomes the first of its node."""
    states.node[number], states.came[number], states.by[number] = state.node, state.came, state.by
    states.begun_s[number], states.at_s[number] = state.begun_s, state.at_s
    states.until_s[number], states.stale[number] = state.until_s, False
    states.next_of[number] = head[state.node]
    head[state.node] = number


#: When the goal would be come to, and how long before it is left, by which state and move, when.
Due = tuple[float, float, int, int, float]
#: A state and when it is gone on from, the weight of the search, and when the goal is free.
Terms = tuple[int, float, float, float]
#: In place of a move: a state itself.
_STATE = -1


class SearchEnds(NamedTuple):
    """From which node to which, from when on, and how long to stay there; inf: for good [s]."""

    start: int
    goal: int
    ready_s: float
    stay_s: float


class FoundWay(NamedTuple):
    """The moves of a way, in order: nodes (L + 1,), when each move begins and ends [s], (L,).

    `reached` is False where there is no way, `tried` counts moves that were looked at.
    """

    reached: bool
    nodes: Ints
    moves: Ints
    """Joins by their numbers; from the number of joins on, kinds of the lattice's moves."""
    begins_s: Floats
    arrives_s: Floats
    tried: int


@compiled
def search(
    graph: Graph, guide: Guide, taken: Taken, ends: SearchEnds, effort: tuple[float, int]
) -> FoundWay:
    """The way from start to goal, given up after so many moves, the second of `effort`.

    The first weighs the time that is left to the goal: with more than 1 the search looks at fewer
    moves, and the way may take longer.
    """
    weight, most = effort
    # A call with large tuples costs more than its work, so moves are tried within.
    joins, moves, bases = graph.joins, graph.moves, graph.bases
    head = np.full(joins.first.size - 1, -1, np.int64)
    states, count, tried, last = new_states(), 0, 0, -1
    # Due entries, by the arrival at the goal: a state, or a move of it, from 0 on, which begins no
    # sooner than the last number.
    heap = [(0.0, 0.0, 0, _STATE, ends.ready_s)]
    until_s = node_free_until(graph, taken, ends.start, ends.ready_s)
    if until_s > -np.inf and guide.cost_s[ends.start] < np.inf:
        first = SearchState(ends.start, -1, 0, ends.ready_s, ends.ready_s, until_s)
        entered(states, head, 0, first)
        count = 1
    # The goal is not come to for good before all others have passed it.
    least_s = node_free_from(graph, taken, ends.goal, ends.stay_s)
    while count > 0 and tried < most and len(heap) > 0:
        _, _, state, move, begin_s = heappop(heap)
        if states.stale[state]:
            continue
        here = states.node[state]
        if move == _STATE:
            if here == ends.goal and states.until_s[state] >= begin_s + ends.stay_s:
                last = state
                break
            offer_joins(joins, guide, here, heap, (state, begin_s, weight, least_s))
            if here < bases.size:
                offer_moves(graph, guide, here, heap, (state, begin_s, weight, least_s))
            continue
        tried += 1
        within_s = begin_s, states.until_s[state]
        if move < joins.end.size:
            there, lasts_s = joins.end[move], joins.duration_s[move]
            leave_s = first_departure(taken, joins.met, move, 0, within_s)
        else:
            kind = move - joins.end.size
            there, lasts_s = here + moves.far[kind], moves.duration_s[kind]
            leave_s = first_departure(taken, moves.met, kind, bases[here], within_s)
        if leave_s == np.inf:
            continue
        left_s, arrive_s = guide.cost_s[there], leave_s + lasts_s
        until_s = node_free_until(graph, taken, there, arrive_s)
        if sooner(states, head[there], arrive_s, until_s):
            if count == states.node.size:
                states = doubled(states)
            entered(
                states, head, count, SearchState(there, state, move, leave_s, arrive_s, until_s)
            )
            total_s = arrive_s + weight * left_s
            heappush(heap, (max(total_s, least_s), left_s, count, _STATE, arrive_s))
            count += 1
        # Once more, for the next safe interval of its end, but not before that is its turn.
        again_s = max(leave_s, until_s - lasts_s) + INSTANT_S
        if again_s <= states.until_s[state] and again_s < np.inf:
            total_s = again_s + lasts_s + weight * left_s
            heappush(heap, (max(total_s, least_s), left_s, state, move, again_s))
    return way_to(states, last, ends.start, tried)


@compiled
def offer_joins(joins: Joins, guide: Guide, here: int, heap: list[Due], terms: Terms) -> None:
    """Queue the open joins of a node by their turns."""
    state, begin_s, weight, least_s = terms
    for join in joins.onward[joins.first[here] : joins.first[here + 1]]:
        left_s = guide.cost_s[joins.end[join]]
        if not guide.barred[join] and left_s < np.inf:
            total_s = begin_s + joins.duration_s[join] + weight * left_s
            heappush(heap, (max(total_s, least_s), left_s, state, join, begin_s))


@compiled
def offer_moves(graph: Graph, guide: Guide, here: int, heap: list[Due], terms: Terms) -> None:
    """Queue the open moves of a lattice node by their turns."""
    state, begin_s, weight, least_s = terms
    # A call with large tuples costs more than its work, so all is done within one.
    far, line, steps = graph.moves.far, graph.moves.line, graph.moves.steps
    duration_s, runs, cost_s = graph.moves.duration_s, guide.runs, guide.cost_s
    often, aligned = graph.moves.often, graph.aligned
    yaw = here // graph.places
    joins = graph.joins.end.size
    for kind in range(graph.moves.first[yaw], graph.moves.first[yaw + 1]):
        if runs[line[kind], here] < steps[kind]:
            continue
        there = here + far[kind]
        left_s = cost_s[there]
        if left_s < np.inf and (often[kind] or aligned[there]):
            total_s = begin_s + duration_s[kind] + weight * left_s
            heappush(heap, (max(total_s, least_s), left_s, state, joins + kind, begin_s))


@compiled
def sooner(states: States, first: int, arrive_s: float, until_s: float) -> bool:
    """Whether no state of a node has this safe interval as soon; a later one is given up."""
    if until_s == -np.inf:
        return False
    other = first
    while other >= 0:
        if states.until_s[other] == until_s and states.at_s[other] <= arrive_s + INSTANT_S:
            return False
        if states.until_s[other] == until_s:
            states.stale[other] = True
        other = states.next_of[other]
    return True


@compiled
def node_free_until(graph: Graph, taken: Taken, node: int, now_s: float) -> float:
    """Up to when the parcel may stand at a node where it may now [s]; -inf where it may not."""
    if node < graph.bases.size:
        yaw = node // graph.places
        own = slice(graph.stand[yaw], graph.stand[yaw + 1])
        return free_until(taken, graph.bases[node], graph.stand_tile[own], now_s)
    extra = node - graph.bases.size
    own = slice(graph.joins.stand[extra], graph.joins.stand[extra + 1])
    return free_until(taken, 0, graph.joins.stand_tile[own], now_s)


@compiled
def node_free_from(graph: Graph, taken: Taken, node: int, stay_s: float) -> float:
    """From when on a node that is not of the lattice is free for good [s]; -inf to stay less."""
    extra, from_s = node - graph.bases.size, -np.inf
    if stay_s < np.inf:
        return from_s
    for index in range(graph.joins.stand[extra], graph.joins.stand[extra + 1]):
        from_s = max(from_s, taken.last_s[graph.joins.stand_tile[index]])
    return from_s


@compiled
def way_to(states: States, last: int, start: int, tried: int) -> FoundWay:
    """The way to a state, -1 for none."""
    length, state = 0, last
    while state > 0:
        length, state = length + 1, states.came[state]
    nodes, moves = np.full(length + 1, start), np.empty(length, np.int64)
    begins_s, arrives_s = np.empty(length), np.empty(length)
    state = last
    for index in range(length - 1, -1, -1):
        moves[index], nodes[index + 1] = states.by[state], states.node[state]
        begins_s[index], arrives_s[index] = states.begun_s[state], states.at_s[state]
        state = states.came[state]
    return FoundWay(last >= 0, nodes, moves, begins_s, arrives_s, tried)
