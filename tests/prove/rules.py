"""The conditions of every state of a table: right of way, told from outside."""

from mdms_cell.rights.right_of_way import PROMISED, UNDER
from tests.prove.cells import Memory
from tests.prove.parcels import Situation

Links = list[dict[int, int]]


class Judge:
    """Holds what parcels and cells do against the rules.

    `links`: the neighbours of each cell by direction; `after_lease_beats`: for how long a cell
    that a lease of has ended is promised to no other; `reaction_beats`: how long a parcel wishes
    before it can be there.
    """

    def __init__(self, links: Links, after_lease_beats: int, reaction_beats: int) -> None:
        self._links = links
        self._after_lease_beats = after_lease_beats
        self._reaction_beats = reaction_beats

    def broken_rule(self, parcels: tuple[Situation, ...], cells: list[Memory]) -> str | None:
        """The first rule that does not hold."""
        covered: dict[int, int] = {}
        for identity, parcel in enumerate(parcels, 1):
            for cell in parcel.covers:
                if covered.setdefault(cell, identity) != identity:
                    return "two parcels touch"
        for cell in range(len(cells)):
            holders = self._holders(cells, cell)
            if len(holders) > 1:
                return f"cell {cell} is promised to two parcels"
            if cell in covered and holders - {covered[cell]}:
                return f"cell {cell} is promised while another stands there"
        for cell, memory in enumerate(cells):
            rule = self._turning_too_long(parcels, cells, cell) if memory.drive else None
            if rule:
                return rule
        return None

    def _holders(self, cells: list[Memory], cell: int) -> set[int]:
        """The parcels that a cell is promised to, by itself or by those that count on it."""
        memory = cells[cell]
        holders = {memory.identity} if memory.state >= PROMISED else set()
        for direction, there in self._links[cell].items():
            other = cells[there]
            if other.state == UNDER and any(said[0] == direction ^ 4 for said in other.said):
                holders.add(other.identity)
        return holders

    def _turning_too_long(
        self, parcels: tuple[Situation, ...], cells: list[Memory], cell: int
    ) -> str | None:
        """Whether the wheels of a cell may turn for longer than a lease that its parcel needs."""
        turning = cells[cell]
        parcel = parcels[turning.identity - 1]
        for there, other in enumerate(cells):
            if other.identity != turning.identity or other.state != UNDER:
                continue
            if there != cell and parcel.waits and parcel.since < self._reaction_beats:
                continue
            for direction, needed in self._links[there].items():
                if not other.wants >> direction & 1 or cells[needed].down:
                    continue
                left = cells[needed].bound - (self._after_lease_beats if there == cell else 0)
                promised = cells[needed].promised in (0, turning.identity)
                if not promised or turning.drive > left:
                    return (
                        f"wheels of {cell} turn for {turning.drive} beats, "
                        f"the lease of {needed} lasts {left}"
                    )
        return None
