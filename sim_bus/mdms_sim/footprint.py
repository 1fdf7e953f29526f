"""What parcels cover of the table, and where they are wanted [m; table frame]."""

from math import cos, pi, sin

import numpy as np

from mdms_sim.physics.shapes import outline_of
from mdms_sim.record import Floats
from mdms_sim.scenario import Goal, Parcel, Scenario

#: Corners that make a disc look round.
DISC_CORNERS = 72


def goal_of(scenario: Scenario, parcel: Parcel) -> Goal | None:
    """Where a parcel is steered to, if the motion steers at all."""
    return parcel.goal if scenario.motion.field == "goal" else None


def outline_m(pose: Floats, parcel: Parcel) -> Floats:
    """Corners of a parcel at a pose (x, y, yaw), counter-clockwise, shape (n, 2)."""
    turned = np.array([[cos(pose[2]), sin(pose[2])], [-sin(pose[2]), cos(pose[2])]])
    corners_m: Floats = own_outline_m(parcel) @ turned + pose[:2]
    return corners_m


def own_outline_m(parcel: Parcel) -> Floats:
    """Corners of a parcel in its own frame, counter-clockwise, shape (n, 2)."""
    outline = outline_of(parcel)
    if len(outline.edges):
        corners_m: Floats = outline.edges[:, 3:5]
        return corners_m
    turns_rad = np.arange(DISC_CORNERS) * (2 * pi / DISC_CORNERS)
    return outline.radius_m * np.column_stack((np.cos(turns_rad), np.sin(turns_rad)))
