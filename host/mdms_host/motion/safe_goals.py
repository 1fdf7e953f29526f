"""Whether a parcel stands safely: at its start, at its goal and on the straight way between.

Goals at which a parcel would tip, or on the straight way to which, are refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, hypot, inf
from types import MappingProxyType

import numpy as np

from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.footholds import INSET_M, MARGIN_M, Footholds
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.trajectory.path import shorter_turn_rad
from mdms_model.arrays import Floats
from mdms_model.outline import Outline
from mdms_model.statics.support_margin import support_margins_m

#: How far a corner moves from one place of the way that is checked to the next, at most.
_STEP_M = 0.002


@dataclass(frozen=True, slots=True)
class SupportedParcel:
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


def least_footing(
    wheel_m: Floats, load: SupportedParcel, start: Floats, goal: GoalPose | None
) -> Footing:
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


def straight_way(start: Floats, goal: GoalPose | None, reach_m: float) -> Floats:
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


#: A parcel that stands no safer than this may go to where it stands as it does [m].
_SAME_M = 0.001

Places = Mapping[str, tuple[float, float]]


class TippingError(ValueError):
    """A parcel would tip at a goal, or on its way there."""


class SafeGoals:
    """Checks goals of parcels on a layout.

    `centres_of_mass_m` are those of parcels that have them beside their origins, in their frames.
    """

    def __init__(self, layout: Layout, centres_of_mass_m: Places = MappingProxyType({})) -> None:
        self._layout = layout
        self._centres_of_mass_m = centres_of_mass_m

    def check(
        self, parcel: Parcel, start: Floats | None, goal: GoalPose, *, straight: bool
    ) -> None:
        """Raises `TippingError` where the parcel would tip that lies at `start`, None: anywhere.

        The way counts too if it is `straight`. A parcel that is about to tip where it is may stay
        there, and be taken to where it stands no worse.
        """
        turned_rad = 0.0 if start is None else float(start[2])
        yaw_rad = turned_rad if goal.yaw_rad is None else goal.yaw_rad
        there_m = self._margin_m(parcel, np.array([goal.x_m, goal.y_m, yaw_rad]), None)
        here_m = inf if start is None else self._margin_m(parcel, start, None)
        if there_m < min(MARGIN_M, here_m - _SAME_M):
            raise TippingError(
                f"{parcel.name} would tip there: its centre of mass would not be "
                f"{1e3 * MARGIN_M:.0f} mm inside the wheels under it"
            )
        if start is None or not straight or here_m < MARGIN_M:
            return
        if self._margin_m(parcel, start, goal) < MARGIN_M:
            raise TippingError(f"{parcel.name} would tip on the straight way there")

    def _margin_m(self, parcel: Parcel, start: Floats, goal: GoalPose | None) -> float:
        """How far the centre of mass stays inside the supports at a pose, or on the way from it."""
        centre_m = self._centres_of_mass_m.get(parcel.name, (0.0, 0.0))
        footholds = Footholds(self._layout, parcel.footprint, centre_m)
        poses = straight_way(start, goal, parcel.footprint.reach_m)
        return float(footholds.margins_m(poses, INSET_M).min())
