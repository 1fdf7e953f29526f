"""What a person asks of parcels: goals, only where they stand safely, and names.

A parcel follows a goal that is dragged only as long as there is a hand on it.
"""

from collections.abc import Callable, Mapping
from dataclasses import astuple, replace
from types import MappingProxyType

import numpy as np

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.footing import MARGIN_M, Load, least_footing
from mdms_host.motion.goal import Goal
from mdms_host.page import commands
from mdms_host.page.commands import RefusedError
from mdms_host.page.shown.things import corners_m
from mdms_model.arrays import Floats
from mdms_model.outline import polygon_outline

#: A goal that is dragged is sent again at least this often by a page that is there [s].
HELD_S = 1.0
#: Supports that are farther from a parcel's way do not matter.
_BESIDE_M = 0.01

Places = Mapping[str, tuple[float, float]]


class ParcelsByHand:
    """Sets goals of a coordinator's parcels, and names them; `wall_s` returns the machine's time.

    `centres_of_mass_m` are those of parcels that have them beside their origins, in their frames.
    """

    def __init__(
        self,
        layout: Layout,
        wall_s: Callable[[], float],
        centres_of_mass_m: Places = MappingProxyType({}),
    ) -> None:
        self._layout = layout
        self._wall_s = wall_s
        self._centres_of_mass_m = centres_of_mass_m
        #: When each goal that is dragged came last, and whose parcels these are.
        self._held: dict[str, float] = {}
        self._holder: Coordinator | None = None

    def set_goal(self, coordinator: Coordinator, command: commands.Goal) -> None:
        """Steer a parcel there from now on. Raises `RefusedError`.

        What is dragged to where it cannot go is held at the goal before.
        """
        self._leave_others(coordinator)
        if command.held and command.parcel in self._held:
            self._held[command.parcel] = self._wall_s()
        goal = _goal_of(coordinator, command)
        parcel = coordinator.tracker.parcels.get(command.parcel)
        if parcel is not None:
            self._check(coordinator, parcel, goal)
        try:
            coordinator.set_goal(command.parcel, goal)
        except KeyError:
            if parcel is not None:
                raise RefusedError(f"the program that runs does not steer {parcel.name}") from None
            raise RefusedError(f"there is no parcel {command.parcel!r:.60}") from None
        except ValueError as error:
            raise RefusedError(str(error)) from None
        self._held.pop(command.parcel, None)
        if command.held:
            self._held[command.parcel] = self._wall_s()

    def let_go(self, coordinator: Coordinator | None) -> list[str]:
        """Have parcels stay whose goals nobody holds any more; returns their names."""
        self._leave_others(coordinator)
        now_s = self._wall_s()
        gone = [name for name, held_s in self._held.items() if now_s - held_s > HELD_S]
        for name in gone:
            del self._held[name]
        if coordinator is None or coordinator.stopped:
            return []
        return [name for name in gone if _stay(coordinator, name)]

    def _leave_others(self, coordinator: Coordinator | None) -> None:
        """A hand that dragged a goal of a program before has nothing to do with this one."""
        if coordinator is not self._holder:
            self._held.clear()
            self._holder = coordinator

    def name(self, coordinator: Coordinator, command: commands.Name) -> None:
        """Take what is unknown for a parcel. Raises `RefusedError`."""
        if not command.name.strip():
            raise RefusedError("name is empty; a parcel needs one")
        parcel = Parcel(
            command.name,
            command.length_m,
            command.width_m,
            shape=command.shape,
            spread_m=command.spread_m,
        )
        try:
            coordinator.tracker.name(command.parcel, parcel)
        except KeyError:
            raise RefusedError(f"nothing unknown is called {command.parcel!r:.60}") from None
        except ValueError as error:
            raise RefusedError(str(error)) from None

    def _check(self, coordinator: Coordinator, parcel: Parcel, goal: Goal) -> None:
        """Raises `RefusedError` where a parcel would tip at its goal, or on its way."""
        estimate = coordinator.estimate(parcel.name)
        start = None if estimate is None else np.array(astuple(estimate))
        turned_rad = 0.0 if start is None else float(start[2])
        yaw_rad = turned_rad if goal.yaw_rad is None else goal.yaw_rad
        if self._margin_m(parcel, np.array([goal.x_m, goal.y_m, yaw_rad]), None) < MARGIN_M:
            raise RefusedError(
                f"{parcel.name} would tip there: its centre of mass would not be "
                f"{1e3 * MARGIN_M:.0f} mm inside the wheels under it"
            )
        # Programs that plan ways plan none on which a parcel tips; one that tips already may go on.
        if start is None or hasattr(type(coordinator.program), "ways"):
            return
        if self._margin_m(parcel, start, None) >= MARGIN_M > self._margin_m(parcel, start, goal):
            raise RefusedError(f"{parcel.name} would tip on the straight way there")

    def _margin_m(self, parcel: Parcel, start: Floats, goal: Goal | None) -> float:
        """How far the centre of mass stays inside the supports at a pose, or on the way from it."""
        outline = polygon_outline(np.array(corners_m(parcel)))
        load = Load(outline, self._centres_of_mass_m.get(parcel.name, (0.0, 0.0)))
        ends_m = np.array([start[:2], start[:2] if goal is None else [goal.x_m, goal.y_m]])
        wheels_m = _near(self._layout.wheel_positions_m, ends_m, outline.radius_m + _BESIDE_M)
        return least_footing(wheels_m, load, start, goal).margin_m


def _near(wheels_m: Floats, ends_m: Floats, reach_m: float) -> Floats:
    """The wheels about a way; all where these are a single row, which counts for a table of one."""
    low_m, high_m = ends_m.min(axis=0) - reach_m, ends_m.max(axis=0) + reach_m
    near: Floats = wheels_m[((wheels_m >= low_m) & (wheels_m <= high_m)).all(axis=1)]
    return near if len(near) > 1 and np.ptp(near, axis=0).all() else wheels_m


def _goal_of(coordinator: Coordinator, command: commands.Goal) -> Goal:
    """The goal, as exact as the one that the parcel has; a disc's turn is seen by no sensor."""
    before = coordinator.goals.get(command.parcel, Goal(0.0, 0.0))
    parcel = coordinator.tracker.parcels.get(command.parcel)
    turned = parcel is None or parcel.shape != "disc"
    yaw_rad = command.yaw_rad if turned else None
    return replace(before, x_m=command.x_m, y_m=command.y_m, yaw_rad=yaw_rad)


def _stay(coordinator: Coordinator, name: str) -> bool:
    """Have a parcel stay where it is believed to be; returns whether it can be."""
    estimate = coordinator.estimate(name) if name in coordinator.tracker.parcels else None
    if estimate is None or name not in coordinator.goals:
        return False
    here = commands.Goal(name, estimate.x_m, estimate.y_m, estimate.yaw_rad)
    try:
        coordinator.set_goal(name, _goal_of(coordinator, here))
    except (KeyError, ValueError):
        # What cannot be given a goal does not go on to the one that it has.
        coordinator.stop()
    return True
