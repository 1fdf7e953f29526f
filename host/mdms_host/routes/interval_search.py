"""Safe-interval path planning: an early way of one parcel among those that have theirs.

After M. Phillips and M. Likhachev (ICRA 2011), for moves that take time and bodies that cover many
tiles. A state is a node and the safe interval in which the parcel stands there, reached as soon as
it can be. From it every move begins as soon as it can in each safe interval of its end. That time
is worked out only when the move's turn comes. The turn is by its cost without other parcels in its
way."""

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from mdms_host.routes.roadmap import Graph, Joins
from mdms_host.routes.safe_intervals import INSTANT_S, Taken, first_departure, free_until
from mdms_host.routes.ways_alone import Guide
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.compiled import compiled

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
