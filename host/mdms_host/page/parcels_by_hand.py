"""What a person asks of parcels: goals, only where they stand safely, and names.

A parcel follows a goal that is dragged only as long as there is a hand on it.
"""

from collections.abc import Callable
from dataclasses import replace

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.estimation.parcel import Parcel
from mdms_host.motion.goal import Goal
from mdms_host.page import commands
from mdms_host.page.commands import RefusedError

#: A goal that is dragged is sent again at least this often by a page that is there [s].
HELD_S = 1.0


class ParcelsByHand:
    """Sets goals of a coordinator's parcels, and names them; `wall_s` is the machine's time."""

    def __init__(self, wall_s: Callable[[], float]) -> None:
        self._wall_s = wall_s
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
        try:
            coordinator.set_goal(command.parcel, goal)
        except KeyError:
            raise RefusedError(_not_steered(coordinator, command.parcel)) from None
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


def _not_steered(coordinator: Coordinator, name: str) -> str:
    """Why the program that runs steers nothing of this name."""
    if name in coordinator.tracker.unknown:
        return f"{name} is unknown, and is not steered; give it a name first"
    if name not in coordinator.tracker.parcels:
        return f"there is no parcel {name!r:.60}"
    if coordinator.estimate(name) is None:
        return f"{name} has not been found yet; ask again when it has"
    return f"the program that runs does not steer {name}"


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
