"""A program of one goal, as tests of coordination need it."""

from tests.host.motion.driving import traction_of

from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.trajectory.pushes import uniform_mass
from mdms_host.programs.program import Member, TableProgram
from mdms_host.programs.table import Table
from mdms_host.programs.tasks import main_of
from mdms_host.programs.traffic.by_host import TableTraffic
from mdms_host.programs.traffic.dispatch import VirtualExecutor
from mdms_host.programs.traffic.ride import Load
from mdms_host.routes.route import TrapezoidPace

#: The parcel of a `RollingArray` speeds up as one of this mass, as seen through its drives.
_ROLLING_KG = 1.6


def program_to(goal: GoalPose, parcel: Parcel, layout: Layout) -> TableProgram:
    loads = {parcel.name: Load(parcel.footprint, uniform_mass(parcel.footprint, _ROLLING_KG))}
    traction = traction_of(layout)
    traffic = TableTraffic(traction, TrapezoidPace(), VirtualExecutor(), loads, hangs=True)
    half_m = layout.columns * layout.pitch_m / 2, layout.rows * layout.pitch_m / 2
    member = Member(parcel.name, "", parcel.length_m, parcel.width_m)
    program = TableProgram(main_of(()), Table(half_m, (), traffic), [member], traffic)
    program.keep_goals({parcel.name: goal})
    return program
