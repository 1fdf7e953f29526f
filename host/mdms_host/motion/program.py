"""What the array is to do: from the parcels' estimated poses to every wheel's reference."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from mdms_host.estimation.rectangle import Rectangle
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.goal import Goal, GoalController, Limits
from mdms_model.arrays import Floats

#: Wheels this far outside a parcel already run as if they were under it.
MARGIN_M = 0.05


class Program(Protocol):
    """Sets all wheels' references [m/s] (the paper's r), step by step."""

    def references_m_s(self, poses: Mapping[str, Floats], step_s: float) -> Floats:
        """References of shape (W,) for the next step, given the poses (x, y, yaw) known now."""
        ...

    @property
    def finished(self) -> bool:
        """Whether what the program is for has been reached."""
        ...

    @property
    def endless(self) -> bool:
        """Whether the program has no end of its own."""
        ...

    @property
    def controllers(self) -> Mapping[str, GoalController]:
        """What steers each parcel that has a goal, by the parcel's name."""
        ...


class FieldProgram:
    """An open-loop field: the same references for as long as it runs."""

    def __init__(self, references_m_s: Floats) -> None:
        self._references_m_s = np.asarray(references_m_s, dtype=np.float64)

    @property
    def finished(self) -> bool:
        """A field is never done."""
        return False

    @property
    def endless(self) -> bool:
        """A field goes on for as long as it may."""
        return True

    @property
    def controllers(self) -> Mapping[str, GoalController]:
        """A field steers no parcel to a goal."""
        return {}

    def references_m_s(self, poses: Mapping[str, Floats], step_s: float) -> Floats:
        """The field's references, shape (W,)."""
        return self._references_m_s


class GoalProgram:
    """Steers each parcel that has a goal to it; wheels near no such parcel stand still.

    `droop` is the nominal speed of a free wheel per reference, a/b of the paper's eq (9): the
    reference is the wanted speed divided by it, times `trim` (W,) where wheels differ.
    """

    def __init__(
        self,
        layout: Layout,
        parcels: tuple[Parcel, ...],
        goals: Mapping[str, Goal],
        droop: float,
        limits: Limits | None = None,
        *,
        trim: Floats | float = 1.0,
    ) -> None:
        self._layout = layout
        self._trim = trim
        self._droop = droop
        self._bottoms = {
            parcel.name: Rectangle(parcel.length_m, parcel.width_m)
            for parcel in parcels
            if parcel.name in goals
        }
        self._controllers = {
            name: GoalController(goals[name], limits or Limits(), bottom.reach_m)
            for name, bottom in self._bottoms.items()
        }

    @property
    def finished(self) -> bool:
        """Whether all parcels have arrived."""
        return all(controller.arrived for controller in self._controllers.values())

    @property
    def endless(self) -> bool:
        """Goals are reached at some time."""
        return False

    @property
    def controllers(self) -> Mapping[str, GoalController]:
        """See `Program`."""
        return self._controllers

    def references_m_s(self, poses: Mapping[str, Floats], step_s: float) -> Floats:
        """References that move every parcel as one rigid body, r = (b/a) J xi, shape (W,)."""
        wheels_m = self._layout.wheel_positions_m
        references_m_s = np.zeros(len(wheels_m))
        nearest_m = np.full(len(wheels_m), MARGIN_M)
        for name, pose in poses.items():
            if name not in self._controllers:
                continue
            twist = self._controllers[name].step(pose, step_s)
            away_m = self._bottoms[name].distance_m(wheels_m, pose)
            mine = away_m < nearest_m
            np.copyto(nearest_m, away_m, where=mine)
            jacobian = self._layout.surface_jacobian(*pose[:2].tolist())
            along = jacobian @ (twist / self._droop) * self._trim
            np.copyto(references_m_s, along, where=mine)
        return references_m_s
