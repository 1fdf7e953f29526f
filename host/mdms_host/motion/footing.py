"""Whether a parcel stands safely: at its start, at its goal and on the straight way between."""

from dataclasses import dataclass, replace
from math import ceil, hypot

import numpy as np

from mdms_host.motion.footholds import INSET_M, MARGIN_M
from mdms_host.motion.goal import Goal
from mdms_host.motion.trajectory.path import shorter_turn_rad
from mdms_model.arrays import Floats
from mdms_model.outline import Outline
from mdms_model.statics.support_margin import support_margins_m

#: How far a corner moves from one place of the way that is checked to the next, at most.
_STEP_M = 0.002


@dataclass(frozen=True, slots=True)
class Load:
    """Load of a parcel on its wheels: its outline, and its centre of mass in its own frame."""

    outline: Outline
    centre_of_mass_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Footing:
    """The place of a way at which a parcel is nearest to tipping, and its margin there [m].

    `share` is how much of the way lies before it: 0 at the start, 1 at the goal.
    """

    pose: Floats
    margin_m: float
    share: float

    @property
    def place(self) -> str:
        """Where on the way that is, in words."""
        if self.share in (0.0, 1.0):
            return "at its goal" if self.share else "at its start"
        return "on its way"


def least_footing(wheel_m: Floats, load: Load, start: Floats, goal: Goal | None) -> Footing:
    """The worst place of the straight way from a pose (x, y, yaw) to a goal; None: of the start.

    `wheel_m` (W, 2) are all wheels [m; table frame]. An unsafe start or goal comes before the way
    between, because a person has chosen it.
    """
    poses = straight_way(start, goal, load.outline.radius_m)
    outline = _inset(load.outline)
    margins_m = support_margins_m(wheel_m, outline, load.centre_of_mass_m, poses)
    ends = [0, len(poses) - 1]
    worst = min(ends, key=lambda end: margins_m[end])
    if margins_m[worst] >= MARGIN_M:
        worst = int(margins_m.argmin())
    return Footing(poses[worst], float(margins_m[worst]), worst / max(len(poses) - 1, 1))


def _inset(outline: Outline) -> Outline:
    """The outline that lies `INSET_M` inside another, edge by edge."""
    edges = outline.edges.copy()
    edges[:, 2] -= INSET_M
    return replace(outline, edges=edges, radius_m=outline.radius_m - INSET_M)


def straight_way(start: Floats, goal: Goal | None, reach_m: float) -> Floats:
    """Poses (P, 3) of the way that `GoalController` takes, the shorter turn; start and goal too."""
    if goal is None:
        return start[None, :]
    turn_rad = 0.0
    if goal.yaw_rad is not None:
        turn_rad = shorter_turn_rad(start[2], goal.yaw_rad)
    way = np.array([goal.x_m - start[0], goal.y_m - start[1], turn_rad])
    length_m = hypot(way[0], way[1]) + abs(turn_rad) * reach_m
    shares = np.linspace(0.0, 1.0, max(ceil(length_m / _STEP_M), 1) + 1)
    poses: Floats = start + shares[:, None] * way
    return poses
