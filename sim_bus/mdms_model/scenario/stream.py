"""Parcels that come and go: where they are set down, and over which edge they leave."""

from dataclasses import dataclass, field
from math import inf

from mdms_model.scenario.limit import ANGLE, PLACE, Limit

SIDES = ("east", "north", "west", "south")


@dataclass(frozen=True, slots=True)
class Stream:
    """Parcels of a stock that are set down one after another, at rest, at one place.

    The next parcel is the first in stock, by the order of `parcels` (their names), of a kind that
    the seed draws from those in stock. It is set down within `spread_m` and `spread_rad` of the
    place as soon as `clear_m` around it is free, but no sooner than `period_s` after the one
    before, and never more than `most` in all (None: no end). A parcel that has left by an exit is
    in stock again. `parcels` start in stock, wherever the scenario puts them.
    """

    parcels: tuple[str, ...] = field(metadata=Limit(items=(1, 63)))
    """Names of the parcels in stock."""
    x_m: float = field(default=0.0, metadata=PLACE)
    """Place along x where they are set down."""
    y_m: float = field(default=0.0, metadata=PLACE)
    """The same along y."""
    yaw_rad: float = field(default=0.0, metadata=ANGLE)
    """Their angle there."""
    start_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1e5))
    """When the first may come."""
    period_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1e5))
    """Least time between two."""
    clear_m: float = field(default=0.02, metadata=Limit(at_least=0.0, at_most=1.0))
    """How much around the place is free before the next comes."""
    spread_m: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=0.1))
    """Largest deviation from the place, drawn by seed."""
    spread_rad: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=0.5))
    """Largest deviation from the angle, drawn by seed."""
    most: int | None = field(default=None, metadata=Limit(at_least=1, at_most=1_000_000))
    """How many come in all; none: no end."""


@dataclass(frozen=True, slots=True)
class Exit:
    """A stretch of one edge of the table, over which parcels leave.

    The conveyor there takes a parcel when its centre of mass has passed the last support, and lies
    between `from_m` and `to_m` along the edge [table frame]. `kinds` are those that are to leave by
    it; empty: any.
    """

    name: str
    """What tasks and programs call it."""
    side: str = field(metadata=Limit(choices=SIDES))
    """The edge of the table."""
    from_m: float = field(default=-1000.0, metadata=PLACE)
    """Beginning of its stretch, along the edge."""
    to_m: float = field(default=1000.0, metadata=PLACE)
    """End of its stretch."""
    kinds: tuple[str, ...] = ()
    """Kinds of parcels that leave by it; none: any that are sent there."""

    def out_m(self, x_m: float, y_m: float, last_m: float) -> float:
        """How far a centre of mass is beyond the last support, at `last_m` to this side [m].

        -inf where it is not within the stretch.
        """
        along_m, across_m = (y_m, x_m) if self.side in ("east", "west") else (x_m, y_m)
        if not self.from_m <= along_m <= self.to_m:
            return -inf
        return (across_m if self.side in ("east", "north") else -across_m) - last_m
