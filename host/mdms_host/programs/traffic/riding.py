"""The interface of a parcel's ride, whichever side drives it, and the ways and times of rides."""

from collections import defaultdict
from collections.abc import Mapping
from typing import Protocol

from mdms_host.estimation.belief import Belief
from mdms_host.programs.order import Order
from mdms_host.routes.route import Route
from mdms_host.routes.space.tiles import Tiles
from mdms_model.arrays import Floats


class Riding(Protocol):
    """One parcel under way on a route, by whomever it is driven; see `ride.Ride`."""

    order: Order
    route: Route
    stopping: bool
    obstructed: bool

    @property
    def progress_m(self) -> float:
        """The path coordinate that the parcel has come to, as is believed [m]."""
        ...

    @property
    def at_rest(self) -> bool:
        """Whether it is commanded to stand."""
        ...

    @property
    def off_path(self) -> bool:
        """Whether it has left its route, and needs another."""
        ...

    @property
    def stands(self) -> bool:
        """Whether it does not get on though it is commanded to."""
        ...

    @property
    def has_come(self) -> bool:
        """Whether the way is done, and the parcel is brought to the goal itself, or held there."""
        ...

    @property
    def arrived(self) -> bool:
        """Whether the parcel is at its goal and has settled."""
        ...

    def has_left(self, belief: Belief | None, last: Floats) -> bool:
        """Whether it has left, given its present belief, and its last believed pose."""
        ...


def ways_of(rides: Mapping[str, Riding]) -> dict[str, Floats]:
    """The poses (K, 3) that are before each parcel under way, where it is now first."""
    return {
        name: ride.route.ahead(ride.progress_m, ride.route.length_m)
        for name, ride in rides.items()
        if not ride.has_come
    }


def due_in_s_of(rides: Mapping[str, Riding], now_s: float) -> dict[str, Floats]:
    """In what time each parcel under way is planned at these poses [s], (K,)."""
    return {
        name: ride.route.ahead_s(ride.progress_m, ride.route.length_m) - now_s
        for name, ride in rides.items()
        if not ride.has_come
    }


def reserved_by(
    rides: Mapping[str, Riding], tiles: Tiles
) -> list[tuple[float, float, float, tuple[str, ...]]]:
    """Tiles that parcels under way have before them, and which do, in their order.

    Middle and side of each [m; table frame].
    """
    visits: dict[int, list[tuple[float, str]]] = defaultdict(list)
    for name, ride in rides.items():
        left = ride.route.visits.leaves_m > ride.progress_m
        if not ride.has_come:
            columns = ride.route.visits.tile[left], ride.route.visits.enters_s[left]
            for tile, enters_s in zip(*(each.tolist() for each in columns), strict=True):
                visits[tile].append((enters_s, name))
    return [
        (
            *tiles.centre_m(tile),
            tiles.side_m,
            tuple(dict.fromkeys(name for _, name in sorted(each))),
        )
        for tile, each in visits.items()
    ]
