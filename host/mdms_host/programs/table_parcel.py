"""Parcels as a program sees them: those on the table, and those that it draws itself."""

from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from math import inf, isfinite, nan
from numbers import Real
from typing import Any, Protocol

from mdms_host.estimation.belief import Belief
from mdms_model.errors import Error
from mdms_model.scenario.limit import MASS

#: Orders a parcel to a place (x, y, yaw), or out by an exit; returns when it is there, or has left.
Move = Callable[["TableParcel", float, float, float | None], Coroutine[Any, Any, None]]
Leave = Callable[["TableParcel", str | None], Coroutine[Any, Any, None]]
#: Outlines that a program may give.
SHAPES = ("rectangle", "disc")


class ProgramError(Error):
    """A program's order is impossible, or has not been carried out: one line for a person."""


class TableParcel:
    """A parcel on the table, by the `name` that it is called by until it has left.

    Its `kind`, `length_m` and `width_m` are as given; `is_round` is whether it is a disc,
    `has_left` whether it has left. A `withdrawn` parcel was found by mistake, and never came.
    """

    def __init__(self, name: str, kind: str, length_m: float, width_m: float, shape: str) -> None:
        self.name = name
        self.kind = kind
        self.length_m = length_m
        self.width_m = width_m
        self.is_round = shape == "disc"
        self._belief: Belief | None = None
        self._orders: tuple[Move, Leave] | None = None
        self.has_left = False
        self.withdrawn = False

    def __repr__(self) -> str:
        return f"<parcel {self.name}>"

    @property
    def found(self) -> bool:
        """Whether it is known where it is."""
        return self._belief is not None

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where it is believed to be: x, y, yaw [m, m, rad; table frame]. Raises ProgramError."""
        if self._belief is None:
            raise ProgramError(f"{self.name} is not on the table, or has not been found")
        x_m, y_m, yaw_rad = self._belief.pose.tolist()
        return x_m, y_m, yaw_rad

    async def move(self, x_m: float, y_m: float, yaw_rad: float | None = None) -> None:
        """Be at a place [m; table frame], turned so if `yaw_rad` is given; returns when there.

        Returns too when the parcel has been ordered elsewhere meanwhile. Raises ProgramError when
        it cannot come there.
        """
        if self._orders is None:
            raise ProgramError(f"{self.name} has left the table")
        await self._orders[0](self, x_m, y_m, yaw_rad)

    async def leave(self, exit: str | None = None) -> None:
        """Leave by an exit, or the one for the parcel's kind; returns when it has left.

        Raises ProgramError where there is no such exit, or no way to it.
        """
        if self._orders is None:
            raise ProgramError(f"{self.name} has left the table")
        await self._orders[1](self, exit)

    def _carried_by(self, orders: tuple[Move, Leave] | None) -> None:
        """Take orders from this table; None once the parcel has left it."""
        self._orders = orders

    def _see(self, belief: Belief | None) -> None:
        """Take in the present belief of it."""
        self._belief = belief


def number_of(
    value: object,
    what: str,
    wanted: str = "a number",
    fits: Callable[[float], bool] = isfinite,
) -> float:
    """A finite number as a float; a cycle that reckons with anything else would break.

    Raises ProgramError.
    """
    try:
        number = float(value) if isinstance(value, Real) else nan
    except (OverflowError, TypeError):
        # One too large, or a time of numpy.
        number = inf
    if not (isfinite(number) and fits(number)):
        raise ProgramError(f"{what} is {value!r:.40}, but must be {wanted}")
    return number


@dataclass(frozen=True, slots=True)
class Newcomer:
    """A parcel that was not in the scenario, and the `name` that it gets.

    Without a size the size that sensors show is taken. `shape` is 'rectangle' or 'disc'. A
    `mass_kg` of None is an unknown mass. Raises ProgramError for impossible sizes and masses.
    """

    name: str
    length_m: float | None = None
    width_m: float | None = None
    shape: str = "rectangle"
    kind: str = ""
    mass_kg: float | None = None

    def __post_init__(self) -> None:
        for key in ("length_m", "width_m", "mass_kg"):
            value = getattr(self, key)
            if value is not None:
                what = f"{key} of {self.name}"
                number = number_of(value, what, "above 0", lambda number: number > 0.0)
                object.__setattr__(self, key, number)
        least_kg, most_kg = MASS["at_least"], MASS["at_most"]
        if self.mass_kg is not None and not least_kg <= self.mass_kg <= most_kg:
            raise ProgramError(
                f"mass_kg of {self.name} is {self.mass_kg!r}, but must be at least {least_kg:g} "
                f"and at most {most_kg:g}"
            )
        if self.shape not in SHAPES:
            raise ProgramError(
                f"shape of {self.name} is {self.shape!r}, but must be one of {SHAPES}"
            )


class Newcomers(Protocol):
    """Finds parcels that a program announces or names; see `newcomers`."""

    def announce(self, newcomer: Newcomer, near_m: tuple[float, float] | None) -> None:
        """Expect a parcel, near a place or anywhere. Raises ProgramError."""
        ...

    def name(self, unknown: str, newcomer: Newcomer) -> None:
        """Take something unknown for a parcel. Raises ProgramError."""
        ...

    def give_up(self, name: str) -> None:
        """Expect a parcel no more, which has not been found."""
        ...
