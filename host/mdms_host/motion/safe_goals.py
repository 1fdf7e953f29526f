"""Refuses goals at which a parcel would tip, or on the straight way to which."""

from collections.abc import Mapping
from math import inf
from types import MappingProxyType

import numpy as np

from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.footholds import INSET_M, MARGIN_M, Footholds
from mdms_host.motion.footing import straight_way
from mdms_host.motion.goal import Goal
from mdms_model.arrays import Floats

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

    def check(self, parcel: Parcel, start: Floats | None, goal: Goal, *, straight: bool) -> None:
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

    def _margin_m(self, parcel: Parcel, start: Floats, goal: Goal | None) -> float:
        """How far the centre of mass stays inside the supports at a pose, or on the way from it."""
        centre_m = self._centres_of_mass_m.get(parcel.name, (0.0, 0.0))
        footholds = Footholds(self._layout, parcel.bottom, centre_m)
        poses = straight_way(start, goal, parcel.bottom.reach_m)
        return float(footholds.margins_m(poses, INSET_M).min())
