"""What a person should know of a run: arrivals, and what does not move as it is to."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Protocol

from mdms_host.coordination.cell_setup.bring_up import BringUpCell
from mdms_host.coordination.watching.following import Following
from mdms_host.coordination.watching.missing import Missing
from mdms_model.arrays import Bools, Floats


class Steered(Protocol):
    """A parcel that is steered to a goal, by whomever."""

    @property
    def arrived(self) -> bool:
        """Whether it is there."""
        ...


class Watch:
    """Watches the wheels of `axes` axes a cell, and the parcels that are steered, by name.

    `arrived_s` is when each parcel came to its goal, of those that are there [s].
    """

    def __init__(
        self, cells: Sequence[BringUpCell], axes: int, controllers: Mapping[str, Steered]
    ) -> None:
        self.arrived_s: dict[str, float] = {}
        self._cells = cells
        self._axes = axes
        self._controllers = controllers
        self._following = Following(axes * len(cells))
        self._missing = Missing()

    @property
    def standing(self) -> Bools:
        """Wheels that do not follow their references, shape (W,)."""
        return self._following.standing

    def wheels(self, commanded_m_s: Floats, speed_m_s: Floats, step_s: float) -> Iterator[str]:
        """Troubles of wheels, given the speeds commanded in the last cycle, and those reported."""
        for wheel in self._following.step(commanded_m_s, speed_m_s, step_s):
            cell, axis = divmod(wheel, self._axes)
            yield (
                f"{self._cells[cell].name} axis {axis + 1} does not follow: it stands, "
                f"commanded to run at {1e3 * commanded_m_s[wheel]:.0f} mm/s "
                "(wheel held, encoder stuck, no supply?)"
            )

    def arrivals(self, now_s: float) -> Iterator[str]:
        """Parcels that have come to their goals since the last call."""
        for name, controller in self._controllers.items():
            if not controller.arrived:
                self.arrived_s.pop(name, None)
            elif name not in self.arrived_s:
                self.arrived_s[name] = now_s
                yield f"{name} has arrived"

    def parcels(
        self, awaited: Collection[str], found: Collection[str], step_s: float
    ) -> Iterator[str]:
        """Troubles of parcels, given those that the program awaits, and those that are found."""
        yield from self._missing.step(awaited, found, step_s)
