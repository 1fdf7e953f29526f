"""Parcels for the planner's tests."""

import numpy as np

from mdms_host.estimation.footprint import Rectangle
from mdms_host.routes.planning_problem import RouteTask
from mdms_host.routes.support import Shape

BOX = Shape(Rectangle(0.28, 0.28))
LONG = Shape(Rectangle(0.40, 0.30))

Pose = tuple[float, ...]


def task(name: str, start: Pose, goal: Pose | None, shape: Shape = BOX, **more: bool) -> RouteTask:
    """A parcel at rest."""
    return RouteTask(name, shape, np.array(start), None if goal is None else np.array(goal), **more)
