"""States of the search: nodes, each in a safe interval, and how each was come to."""

from typing import NamedTuple

import numpy as np

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


class State(NamedTuple):
    """One state, as `States` has it."""

    node: int
    came: int
    by: int
    begun_s: float
    at_s: float
    until_s: float


@compiled
def entered(states: States, head: Ints, number: int, state: State) -> None:
    """Enter a state, which becomes the first of its node."""
    states.node[number], states.came[number], states.by[number] = state.node, state.came, state.by
    states.begun_s[number], states.at_s[number] = state.begun_s, state.at_s
    states.until_s[number], states.stale[number] = state.until_s, False
    states.next_of[number] = head[state.node]
    head[state.node] = number
