"""The tables that are explored, with their bounds."""

from typing import Any, NamedTuple

from mdms_cell.rights import right_of_way
from tests.prove.cells import Rules
from tests.prove.exploration import Exploration, Found
from tests.prove.lost import GridAround, LostExploration, Times
from tests.prove.parcels import Grid
from tests.prove.progress import Progress


class Table(NamedTuple):
    """A table of columns by rows, and the cells that each parcel stands on at first."""

    columns: int
    rows: int
    parcels: tuple[tuple[int, ...], ...]
    rules: Rules
    crash: bool = True

    def explore(self, module: Any = right_of_way, most_states: int = 10_000_000) -> Found:
        """Explore to closure, then look for parcels that are stuck; raises CounterexampleError."""
        exploration = Exploration(
            Grid(self.columns, self.rows),
            tuple(frozenset(parcel) for parcel in self.parcels),
            rules=self.rules,
            crash=self.crash,
            module=module,
            most_states=most_states,
        )
        found = exploration.run()
        for identity in range(1, len(self.parcels) + 1):
            Progress(exploration, identity).judge(exploration.parents)
        return found


class LostTable(NamedTuple):
    """Four cells in a row, of which the second is lost, and a parcel at either end.

    With `crossing` the first parcel has come over the lost cell already. That cell is cut off.
    """

    crossing: bool

    def explore(self, module: Any = right_of_way, most_states: int = 10_000_000) -> Found:
        """Explore to closure; raises CounterexampleError."""
        return LostExploration(
            GridAround(4, 1, lost=1),
            (frozenset((0,)), frozenset((3,))),
            rules=Rules(lease=1, late=0, disturbed=0),
            times=Times(),
            crossing=self.crossing,
            module=module,
            most_states=most_states,
        ).run()


_ANY = Rules(lease=3, late=1)
_ANY_SHORT = Rules(lease=1, late=0)
_SINGLE = Rules(lease=3, late=1, disturbed=1)
_LATEST = Rules(lease=3, late=2, disturbed=1)
_TWO_STEPS = Rules(lease=2, late=0, hops=2, disturbed=1)
_SHORT = Rules(lease=2, late=0, disturbed=1)
_SHORTEST = Rules(lease=1, late=0, disturbed=1)
_UNPLACED = Rules(lease=1, late=0, placed=False)
_SET_DOWN = Rules(lease=1, late=0, set_down=True)
_UPON = Rules(lease=1, late=0, set_down=True, upon=True)
_UNDISTURBED = Rules(lease=3, late=0, disturbed=0)

#: Explored with the tests, within seconds. Parcels are of one cell, a lease is of three beats, an
#: estimate at most one beat late, and at most one link is disturbed within a beat, unless said.
QUICK: dict[str, Table] = {
    "2 x 1, a parcel, any lost or late, a crash": Table(2, 1, ((0,),), _ANY),
    "5 x 1, a parcel of three cells, lease 2, none late": Table(
        5, 1, ((0, 1, 2),), _TWO_STEPS, crash=False
    ),
    "3 x 1, two parcels, lease 1, any lost, none late, a crash": Table(
        3, 1, ((0,), (2,)), _ANY_SHORT
    ),
    "3 x 1, parcels of two cells and one, lease 1, any lost, none late, a crash": Table(
        3, 1, ((0, 1), (2,)), _ANY_SHORT
    ),
    "3 x 1, parcels of two cells and one, lease 1, any lost, no place told, a crash": Table(
        3, 1, ((0, 1), (2,)), _UNPLACED
    ),
    "3 x 1, two parcels, lease 1, any lost, none late, things set down, a crash": Table(
        3, 1, ((0,), (2,)), _SET_DOWN
    ),
    "2 x 2, two parcels, lease 1, any lost, none late, things set down anywhere": Table(
        2, 2, ((0,), (3,)), _UPON, crash=False
    ),
}

#: Explored by `python -m tests.prove` as well, within minutes.
LONG: dict[str, Table | LostTable] = {
    "4 x 1, two parcels, one on a lost cell that comes back": LostTable(crossing=True),
    "2 x 2, a parcel, a crash": Table(2, 2, ((0,),), _SINGLE),
    "4 x 1, a parcel of two cells, a crash": Table(4, 1, ((0, 1),), _SINGLE),
    "4 x 1, parcels of two cells and one, lease 2, none late": Table(
        4, 1, ((0, 1), (3,)), _SHORT, crash=False
    ),
    "3 x 1, two parcels, any lost or late, a crash": Table(3, 1, ((0,), (2,)), _ANY),
    "2 x 2, two parcels, lease 1, any lost, none late, a crash": Table(
        2, 2, ((0,), (3,)), _ANY_SHORT
    ),
    "2 x 2, two parcels, lease 1, any lost, none late, things set down, a crash": Table(
        2, 2, ((0,), (3,)), _SET_DOWN
    ),
    "2 x 2, a parcel, two beats late, a crash": Table(2, 2, ((0,),), _LATEST),
    "2 x 2, two parcels, none lost or late, a crash": Table(2, 2, ((0,), (3,)), _UNDISTURBED),
    "2 x 2, two parcels, lease 2, none late, a crash": Table(2, 2, ((0,), (3,)), _SHORT),
    "3 x 2, two parcels, none lost or late": Table(3, 2, ((0,), (5,)), _UNDISTURBED, crash=False),
    "3 x 2, two parcels, lease 1, none late": Table(3, 2, ((0,), (5,)), _SHORTEST, crash=False),
    "3 x 2, parcels of two cells and one, lease 1, none lost or late": Table(
        3, 2, ((0, 1), (5,)), Rules(lease=1, late=0, disturbed=0), crash=False
    ),
    "2 x 2, two parcels": Table(2, 2, ((0,), (3,)), _SINGLE, crash=False),
    "3 x 3, two parcels, none lost or late": Table(3, 3, ((0,), (8,)), _UNDISTURBED, crash=False),
}
