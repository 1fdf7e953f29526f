"""When each tile is taken, and from that when a pose or a move is free (SIPP's safe intervals)."""

from typing import NamedTuple

import numpy as np

from mdms_host.routes.moves import Met
from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled

#: A tile that is free up to an instant is left this much before. A tile that is free from an
#: instant on is entered this much after it [s].
INSTANT_S = 1e-9
_ROOM = 8


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
        self.taken = _with_room(tiles, _ROOM)

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
