"""Coordinators of 18 cells and a box, as tests of coordination need them."""

import numpy as np
from tests.host.programs.goals import program_to

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.recovery import Policy
from mdms_host.coordination.run_state import Phase
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.program import FieldProgram

LAYOUT = Layout(6, 3, wheels=(WheelPlace(0.0, (0.0, 0.03)), WheelPlace(np.pi / 2, (0.03, 0.0))))
BOX = Parcel("box", 0.36, 0.30)
BOTTOM = Rectangle(0.36, 0.30)
#: No trouble passes.
STRICT = Policy(pauses=0)


def still(layout: Layout = LAYOUT) -> FieldProgram:
    return FieldProgram(np.zeros(len(layout.wheel_cells)))


def steering(goal: GoalPose) -> Coordinator:
    return Coordinator(LAYOUT, program_to(goal, BOX, LAYOUT), parcels=(BOX,))


def running(rolling_array, coordinator: Coordinator, layout: Layout = LAYOUT):
    array = rolling_array(layout, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 1.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    return array
