"""Lost cells that a parcel crosses, as the host agrees on it with the cells around.

The host declares a cell lost for one parcel, in rounds. A round is over when all neighbours have
agreed, and the next round lets the parcel come. If a round takes too long, another one begins, and
the parcel stands meanwhile. So no agreement that counts is older than a lease, and the end of the
host ends the declaration.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf

from mdms_host.layout import Layout
from mdms_host.motion.by_cells.reports import Lasting, Reports, cells_text
from mdms_host.places import neighbours_of
from mdms_protocol.neighbours import lost
from mdms_protocol.neighbours.messages import Lost

#: The period of SYNC of cells that steer [s].
BEAT_S = 0.01
#: A cell has been silent for so long before it is declared lost [s].
LOST_S = lost.LOST_BEATS * BEAT_S
_ROUND_S = lost.ROUND_BEATS * BEAT_S
#: Rounds, and pages of one round, are so far apart [s].
_PAGE_S = 0.02
#: So long after its last round a cell may be declared lost for another parcel [s]. Its neighbours
#: keep their promises for a lease, and then promise nothing for as long as wheels may turn.
_REST_S = 0.5
#: A revoked declaration is repeated so often [s].
_REVOKE_S = 0.05


@dataclass(slots=True)
class Declaration:
    """The declaration of one cell, bound to the parcel of an identity.

    `begun_s` is when its round began, and `sent_s` when a page of it was sent last. `agreed` are
    the neighbours that have agreed in this round. `over` is whether it is revoked.
    """

    identity: int
    number: int = 0
    begun_s: float = -inf
    sent_s: float = -inf
    agreed: set[int] = field(default_factory=set)
    over: bool = False

    def begin_round(self, now_s: float) -> None:
        """Ask all neighbours anew."""
        self.number = self.number % lost.NUMBER_MAX + 1
        self.begun_s, self.sent_s = now_s, -inf
        self.agreed.clear()


class LostCells:
    """Declares the lost cells (from 1) of a layout for parcels that want their squares.

    Notices to a person are passed to `note`.
    """

    def __init__(self, layout: Layout, reports: Reports, note: Callable[[str], None]) -> None:
        self._columns = layout.columns
        self._reports = reports
        self._note = note
        self._neighbours = {
            cell: frozenset(filter(None, neighbours_of(layout, cell)))
            for cell in range(1, layout.cells + 1)
        }
        self._declared: dict[int, Declaration] = {}
        self._together: dict[frozenset[int], Lasting] = {}
        self.silent_s: Mapping[int, float] = {}

    def on_answer(self, cell: int, answer: Lost) -> None:
        """A cell (from 1) has answered a page."""
        its = answer.column + self._columns * (answer.row - 1)
        declared = self._declared.get(its)
        expected = lost.REVOKED if declared is not None and declared.over else lost.AGREED
        if (
            declared is not None
            and (answer.number, answer.identity) == (declared.number, declared.identity)
            and answer.kind == expected
            and cell in self._neighbours[its]
        ):
            declared.agreed.add(cell)

    def step(self, names: Mapping[int, str], now_s: float) -> Iterator[Lost]:
        """The pages to send now; once a cycle. Parcels have these names by identity."""
        for cell in sorted(self._declared.keys() - self._reports.lost):
            yield from self._revoke(cell, now_s)
        for cell in sorted(self._reports.lost):
            wanting = self._wanting(cell)
            if wanting and self._is_lost(cell, now_s) and self._is_bound(cell, wanting, now_s):
                declared = self._declared[cell]
                if declared.begun_s == -inf:
                    self._note(f"{names[declared.identity]} is to cross cell {cell}, which is lost")
                yield from self._round(cell, declared, now_s)

    def _wanting(self, cell: int) -> list[int]:
        """The identities of parcels that want a cell's square; the one of most reports first."""
        reported = list(self._reports.wanting(cell, self._neighbours[cell]))
        return sorted(set(reported), key=lambda each: (-reported.count(each), each))

    def _is_lost(self, cell: int, now_s: float) -> bool:
        """Whether a cell has been silent for long, and all cells around it live."""
        beside = self._neighbours[cell] & self._reports.lost
        together = beside | {cell}
        if beside and self._together.setdefault(together, Lasting()).step(True, now_s):
            self._note(f"{cells_text(together)} are lost side by side: no parcel crosses them")
        return not beside and self.silent_s.get(cell, 0.0) >= LOST_S

    def _is_bound(self, cell: int, wanting: Sequence[int], now_s: float) -> bool:
        """Whether a cell's declaration is for a parcel that wants it; binds it when it is time."""
        declared = self._declared.get(cell)
        if declared is None:
            self._declared[cell] = Declaration(wanting[0])
        elif declared.over or declared.identity not in wanting:
            if now_s < declared.begun_s + _REST_S:
                return False
            self._declared[cell] = Declaration(wanting[0], declared.number)
        return True

    def _round(self, cell: int, declared: Declaration, now_s: float) -> Iterator[Lost]:
        if now_s < declared.sent_s + _PAGE_S:
            return
        if now_s >= declared.begun_s + _ROUND_S:
            # The number after the next: the next one would say that all had agreed in time.
            declared.begin_round(now_s)
            declared.begin_round(now_s)
        elif declared.agreed >= self._neighbours[cell]:
            declared.begin_round(now_s)
        declared.sent_s = now_s
        yield self._page(cell, lost.DECLARED, declared)

    def _revoke(self, cell: int, now_s: float) -> Iterator[Lost]:
        """The cell takes part again: tell its neighbours until all that live have heard it."""
        declared = self._declared[cell]
        if not declared.over:
            declared.begin_round(now_s)
            declared.over = True
        if declared.agreed >= self._neighbours[cell] - self._reports.lost:
            del self._declared[cell]
        elif now_s >= declared.sent_s + _REVOKE_S:
            declared.sent_s = now_s
            yield self._page(cell, lost.REVOKED, declared)

    def _page(self, cell: int, kind: int, declared: Declaration) -> Lost:
        row, column = divmod(cell - 1, self._columns)
        return Lost(kind, column + 1, row + 1, declared.identity, declared.number)
