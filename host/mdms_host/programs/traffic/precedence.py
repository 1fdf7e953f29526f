"""In which order parcels that are under way come over each cell, as it was planned."""

from collections.abc import Mapping
from math import inf

from mdms_host.motion.by_cells.sending import Turn
from mdms_host.routes.reservations import Reservations, Visit
from mdms_host.routes.space.tiles import Tiles

#: A parcel that comes over the same cell again comes twice, if it is planned to be away for longer
#: between [s]. Cells wait twice as long for one that stays beside them: it may be slower by then.
_AWAY_S = 2.5


def orders_over_cells(
    reservations: Reservations,
    tiles: Tiles,
    come_m: Mapping[str, float],
    until_m: Mapping[str, float],
) -> dict[int, tuple[Turn, ...]]:
    """The turns of parcels over each cell (from 1) that more than one of them is yet to come over.

    Each goes from `come_m` of its route to `until_m`; parcels that are not listed come nowhere.
    Tiles are as large as cells.
    """
    orders = {}
    for tile, visits in reservations.order.items():
        turns = _turns([visit for visit in visits if _is_ahead(visit, come_m, until_m)])
        cell = tiles.cell_of(tile)
        if cell is not None and len({turn.parcel for turn in turns}) > 1:
            orders[cell] = turns
    return orders


def _is_ahead(visit: Visit, come_m: Mapping[str, float], until_m: Mapping[str, float]) -> bool:
    name = visit.parcel
    return visit.leaves_m > come_m.get(name, inf) and visit.enters_m < until_m[name]


def _turns(visits: list[Visit]) -> tuple[Turn, ...]:
    turns: list[Turn] = []
    left_s = -inf
    for visit in visits:
        if not turns or visit.parcel != turns[-1].parcel or visit.enters_s > left_s + _AWAY_S:
            turns.append(Turn(visit.parcel, visit.enters_m))
        left_s = visit.leaves_s
    return tuple(turns)
