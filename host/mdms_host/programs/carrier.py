"""The interface of a program to its carrier of parcels."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Protocol

from mdms_host.estimation.belief import Belief, Gain
from mdms_host.estimation.parcel import Parcel
from mdms_host.motion.program import Steered
from mdms_host.motion.trajectory.pushes import Mass
from mdms_host.programs.order import Gate, Order
from mdms_model.arrays import Floats


class Orders(Protocol):
    """Carries out orders for parcels."""

    def give(self, order: Order) -> None:
        """Take an order in place of any other for its parcel."""
        ...

    def stop(self) -> None:
        """Bring all parcels to rest, and hold them there."""
        ...


class Traffic(Orders, Protocol):
    """Carries out orders for parcels, and keeps the parcels out of each other's way."""

    def step(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References of all wheels (W,) [m/s] for the next cycle."""
        ...

    @property
    def speeds_m_s(self) -> Floats:
        """How fast each wheel is to run under the references that were returned last, (W,)."""
        ...

    @property
    def gains(self) -> Mapping[str, Gain]:
        """Gains of the wheels under parcels in the step before these, and their pushes."""
        ...

    def attend(self, tracked: Callable[[], Collection[str]]) -> None:
        """From now on a parcel without a belief has left only if `tracked()` does not name it."""
        ...

    def take_left(self) -> list[str]:
        """Parcels that have left the table since the last call."""
        ...

    def withdraw(self, name: str) -> None:
        """A parcel was never there: any order for it is done, and it is taken for one that left."""
        ...

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """These cells (from 1) are lost, and no others."""
        ...

    def know(self, parcel: Parcel, mass: Mass) -> None:
        """There is to be another parcel."""
        ...

    def take_leaving(self) -> list[tuple[str, Gate | None]]:
        """Parcels that have set out to leave since the last call, and through which gate.

        Without one, a parcel that was to leave has set out for another place.
        """
        ...

    @property
    def at_rest(self) -> bool:
        """Whether all parcels are commanded to stand."""
        ...

    def take_notices(self) -> list[str]:
        """Notices for a person, since the last call."""
        ...

    @property
    def near(self) -> Collection[str]:
        """Parcels about to arrive."""
        ...

    @property
    def plan(self) -> object:
        """The plan that is in effect: another object with each, None before the first."""
        ...

    @property
    def steered(self) -> Mapping[str, Steered]:
        """The follower of each parcel that has been ordered to a place; the same mapping always."""
        ...

    def forget(self, name: str) -> None:
        """Nobody asks for this parcel to be where it was ordered to any more."""
        ...

    @property
    def under_way(self) -> Collection[str]:
        """See `TableProgram`."""
        ...

    @property
    def ways(self) -> Mapping[str, Floats]:
        """See `TableProgram`."""
        ...

    @property
    def due_in_s(self) -> Mapping[str, Floats]:
        """See `TableProgram`."""
        ...

    @property
    def reserved(self) -> Sequence[tuple[float, float, float, tuple[str, ...]]]:
        """See `TableProgram`."""
        ...
