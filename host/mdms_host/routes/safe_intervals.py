"""When each tile is taken, and from that when a pose or a move is free (SIPP's safe intervals)."""

from typing import NamedTuple

import numpy as np

from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled

#: What is free only up to an instant is left this much before, and entered this much after it [s].
INSTANT_S = 1e-9
_ROOM = 8


class Taken(NamedTuple):
    """When each tile is taken and by whom: the first `number` of each row, in no order."""

    number: Ints
    from_s: Floats
    to_s: Floats
    owner: Ints


class TakenTiles:
    """Who takes which tile when; `taken` has room for more as it fills."""

    def __init__(self, tiles: int) -> None:
        self.taken = _with_room(tiles, _ROOM)

    def take(self, owner: int, tiles: Ints, from_s: Floats, to_s: Floats) -> None:
        """An owner takes each of these tiles from an instant to another; a tile may come twice."""
        while not enter(self.taken, owner, tiles, from_s, to_s):
            old = self.taken
            self.taken = _with_room(len(old.number), 2 * old.from_s.shape[1])
            self.taken.number[:] = old.number
            for new, former in zip(self.taken[1:], old[1:], strict=True):
                new[:, : former.shape[1]] = former

    def release(self, owner: int) -> None:
        """An owner takes nothing any more."""
        remove(self.taken, owner)


def _with_room(tiles: int, room: int) -> Taken:
    shape = tiles, room
    owners = np.zeros(shape, dtype=np.int64)
    return Taken(np.zeros(tiles, dtype=np.int64), np.zeros(shape), np.zeros(shape), owners)


@compiled
def enter(taken: Taken, owner: int, tiles: Ints, from_s: Floats, to_s: Floats) -> bool:
    """Enter intervals; False, and nothing of this owner is left, where there is no room for all."""
    for index, tile in enumerate(tiles):
        at = taken.number[tile]
        if at == taken.from_s.shape[1]:
            remove(taken, owner)
            return False
        taken.from_s[tile, at], taken.to_s[tile, at] = from_s[index], to_s[index]
        taken.owner[tile, at] = owner
        taken.number[tile] = at + 1
    return True


@compiled
def remove(taken: Taken, owner: int) -> None:
    """Remove all intervals of an owner."""
    for tile in range(taken.number.size):
        kept = 0
        for at in range(taken.number[tile]):
            if taken.owner[tile, at] != owner:
                taken.from_s[tile, kept] = taken.from_s[tile, at]
                taken.to_s[tile, kept] = taken.to_s[tile, at]
                taken.owner[tile, kept] = taken.owner[tile, at]
                kept += 1
        taken.number[tile] = kept


@compiled
def first_departure(
    taken: Taken,
    tile: Ints,
    spans_s: tuple[Floats, Floats],
    base: int,
    within_s: tuple[float, float],
) -> float:
    """The first instant at which a move may begin so that all its visits are free [s].

    Visits are of tiles (V,), by their numbers less `base`, and in `spans_s` from and to when after
    its begin. It begins from one instant up to another, `within_s`; inf: in none between.
    """
    enters_s, leaves_s = spans_s
    begin_s, settled, visit = within_s[0], 0, 0
    while settled < len(tile):
        place = base + tile[visit]
        settled += 1
        for at in range(taken.number[place]):
            end_s = taken.to_s[place, at]
            if begin_s + enters_s[visit] < end_s and (
                begin_s + leaves_s[visit] > taken.from_s[place, at]
            ):
                begin_s = end_s - enters_s[visit] + INSTANT_S
                if begin_s == np.inf:
                    return np.inf
                settled = 0
        visit = visit + 1 if visit + 1 < len(tile) else 0
    return begin_s if begin_s <= within_s[1] else np.inf


@compiled
def free_until(taken: Taken, base: int, tile: Ints, now_s: float) -> float:
    """Up to when tiles that are free now stay so [s]; -inf where one is taken."""
    until_s = np.inf
    for each in tile:
        place = base + each
        for at in range(taken.number[place]):
            if taken.to_s[place, at] > now_s + INSTANT_S:
                if taken.from_s[place, at] < now_s - INSTANT_S:
                    return -np.inf
                until_s = min(until_s, taken.from_s[place, at])
    return until_s
