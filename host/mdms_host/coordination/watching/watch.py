"""Reports of a run for a person: arrivals, and parcels that do not move as they should."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from math import degrees, radians

from mdms_host.coordination.cell_setup.bring_up import BringUpCell
from mdms_host.coordination.watching.following import Following
from mdms_host.coordination.watching.missing import Missing
from mdms_host.estimation.belief import Belief
from mdms_host.motion.goal import Goal
from mdms_host.motion.program import Steered
from mdms_model.arrays import Bools, Floats

#: The place of a parcel that has arrived is to be known so well, with 95 % [m, rad].
UNSURE_M, UNSURE_RAD = 0.005, radians(2.0)


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

    def arrivals(self, beliefs: Mapping[str, Belief], now_s: float) -> Iterator[str]:
        """Parcels that have come to their goals since the last call, first how well if not well."""
        for name, controller in self._controllers.items():
            if not controller.arrived:
                self.arrived_s.pop(name, None)
            elif name not in self.arrived_s:
                self.arrived_s[name] = now_s
                if name in beliefs and (doubt := _doubt(beliefs[name], controller.goal)):
                    yield doubt
                yield f"{name} has arrived"

    def parcels(
        self, awaited: Collection[str], found: Collection[str], step_s: float
    ) -> Iterator[str]:
        """Troubles of parcels, given those that the program awaits, and those that are found."""
        yield from self._missing.step(awaited, found, step_s)


def _doubt(belief: Belief, goal: Goal) -> str | None:
    """How well a parcel's place is known, where it may well be beside its goal; else None."""
    off_m, off_rad = belief.region
    turned = goal.yaw_rad is not None
    if off_m <= UNSURE_M and not (turned and off_rad > UNSURE_RAD):
        return None
    turn = f" and {degrees(off_rad):.1f} degrees" if turned else ""
    return f"{belief.name} is known to {1e3 * off_m:.1f} mm{turn}: no move shows its place better"
