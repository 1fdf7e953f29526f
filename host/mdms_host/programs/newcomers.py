"""Parcels that a program announces or names: to the tracker, to the traffic, and to the program."""

from collections.abc import Callable
from dataclasses import replace
from math import inf
from typing import Protocol

from mdms_host.estimation.parcel import Parcel, Region
from mdms_host.estimation.size import Size
from mdms_host.motion.trajectory.pushes import UNKNOWN_KG, Mass, uniform_mass
from mdms_host.programs.comings import Register, around
from mdms_host.programs.table import Newcomer, ProgramError


class NamingRegister(Register, Protocol):
    """Where parcels are announced, named and taken off: the tracker."""

    def name(self, unknown: str, parcel: Parcel) -> None:
        """Take an unknown thing for a parcel. Raises KeyError, ValueError."""
        ...

    def take_withdrawn(self) -> list[tuple[Parcel, Region | None]]:
        """Parcels that have not come after all."""
        ...

    def size(self, name: str) -> Size | None:
        """Size of an unknown thing; None for another shape than a rectangle. Raises KeyError."""
        ...


class TrackedNewcomers:
    """See `table_parcel.Newcomers`. `know` has the traffic and the program know a parcel.

    The table's emergency stop holds no parcel heavier than `heaviest_kg`.
    """

    def __init__(
        self,
        register: NamingRegister,
        know: Callable[[Parcel, Mass, str, bool], None],
        heaviest_kg: float = inf,
    ) -> None:
        self._register = register
        self._know = know
        self._heaviest_kg = heaviest_kg

    def announce(self, newcomer: Newcomer, near_m: tuple[float, float] | None) -> None:
        """Expect a parcel, near a place or anywhere. Raises ProgramError."""
        self._refuse_heavier(newcomer)
        parcel = replace(_drawn(newcomer), near_m=near_m)
        region = None if near_m is None else around(near_m)
        try:
            self._register.announce(parcel, region)
        except ValueError as error:
            raise ProgramError(str(error)) from None
        self._know(parcel, _mass_of(newcomer, parcel), newcomer.kind, True)

    def name(self, unknown: str, newcomer: Newcomer) -> None:
        """Take something unknown for a parcel. Raises ProgramError."""
        self._refuse_heavier(newcomer)
        parcel = self._learned(unknown, newcomer) or _drawn(newcomer)
        try:
            self._register.name(unknown, parcel)
        except KeyError:
            raise ProgramError(f"{unknown} is not there any more") from None
        except ValueError as error:
            raise ProgramError(str(error)) from None
        self._know(parcel, _mass_of(newcomer, parcel), newcomer.kind, False)

    def give_up(self, name: str) -> None:
        """Expect a parcel no more, which has not been found."""
        self._register.depart(name)

    def _refuse_heavier(self, newcomer: Newcomer) -> None:
        if (newcomer.mass_kg or 0.0) > self._heaviest_kg:
            raise ProgramError(
                f"{newcomer.name} has {newcomer.mass_kg:g} kg, but the table's emergency stop "
                f"holds {self._heaviest_kg:g} kg at most (stop.mass_kg); take it off the table"
            )

    def _learned(self, unknown: str, newcomer: Newcomer) -> Parcel | None:
        """The parcel as large as sensors show it, where the program has no size."""
        if newcomer.length_m is not None:
            return None
        size = self._register.size(unknown)
        if size is None:
            raise ProgramError(f"{unknown} is no rectangle: {newcomer.name} needs a size")
        return size.parcel(newcomer.name)


def _drawn(newcomer: Newcomer) -> Parcel:
    length_m = newcomer.length_m or 0.0
    return Parcel(newcomer.name, length_m, newcomer.width_m or length_m, shape=newcomer.shape)


def _mass_of(newcomer: Newcomer, parcel: Parcel) -> Mass:
    mass_kg = UNKNOWN_KG if newcomer.mass_kg is None else newcomer.mass_kg
    return uniform_mass(parcel.bottom, mass_kg)
