"""Sends cells the order in which parcels come over them: one cell after another, round and round.

Cells do not acknowledge it, and need it only once the host is gone.
"""

from collections.abc import Iterator, Mapping
from math import inf
from typing import NamedTuple

from mdms_host.layout import Layout
from mdms_protocol.neighbours import precedence as wire
from mdms_protocol.neighbours.messages import Page, Precedence

#: Pages of two cells are so far apart [s].
_PAGE_S = 0.02


class Turn(NamedTuple):
    """A parcel comes over a cell, for the first time on its way from this path coordinate [m]."""

    parcel: str
    enters_m: float


class Precedences:
    """The orders over all cells that have one, or had: those get to know that it is over."""

    def __init__(self, layout: Layout) -> None:
        self._columns = layout.columns
        self._orders: dict[int, tuple[Turn, ...]] = {}
        self._numbers: dict[int, int] = {}
        self._queue: list[int] = []
        self._due_s = -inf

    def set(self, orders: Mapping[int, tuple[Turn, ...]]) -> None:
        """Have these be the orders over cells (from 1), and no others."""
        wanted = {**dict.fromkeys(self._orders, ()), **orders}
        changed = [cell for cell, order in wanted.items() if self._orders.get(cell) != order]
        self._orders = wanted
        for cell in changed:
            self._numbers[cell] = (self._numbers.get(cell, 0) + 1) % wire.NUMBERS
        # Changed orders go first.
        self._queue = [*changed, *(cell for cell in self._queue if cell not in changed)]

    def pages(self, identities: Mapping[str, int], now_s: float) -> Iterator[Page]:
        """The page to send now, if it is time; once a cycle. Parcels have these identities."""
        if not self._queue or now_s < self._due_s:
            return
        self._due_s = now_s + _PAGE_S
        cell = self._queue.pop(0)
        self._queue.append(cell)
        row, column = divmod(cell - 1, self._columns)
        turns = self._orders[cell][: wire.PLACES]
        order = tuple(identities[turn.parcel] for turn in turns)
        yield Precedence(self._numbers[cell], column + 1, row + 1, order)
