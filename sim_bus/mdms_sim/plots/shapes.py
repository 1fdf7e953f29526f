"""Outlines of parcels and where they are wanted [m; table frame]."""

from math import cos, sin

import numpy as np

from mdms_sim.record import Floats
from mdms_sim.scenario import Goal, Parcel, Scenario


def goal_of(scenario: Scenario, parcel: Parcel) -> Goal | None:
    """Where a parcel is steered to, if the motion steers at all."""
    return parcel.goal if scenario.motion.field == "goal" else None


def outline_m(pose: Floats, length_m: float, width_m: float) -> Floats:
    """Corners of a rectangle at a pose (x, y, yaw), counter-clockwise, shape (4, 2)."""
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (length_m / 2, width_m / 2)
    turned = np.array([[cos(pose[2]), sin(pose[2])], [-sin(pose[2]), cos(pose[2])]])
    corners_m: Floats = corners @ turned + pose[:2]
    return corners_m
