"""A box on a table whose cells steer, and cells that report of it as a test says."""

import numpy as np
from tests.host.motion.believing import beliefs

from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.by_cells.sending import CellsMotion
from mdms_host.motion.goal import GoalPose
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages

LAYOUT = Layout(6, 3)
BOX = Parcel("box", 0.36, 0.30)
AT = {"box": np.array([-0.10, 0.0, 0.0])}
THERE = {"box": np.array([0.10, 0.0, 0.5])}
#: The cells with a sensor well under the box at its start.
UNDER = (2, 3, 4, 8, 9, 10, 14, 15, 16)
STEP_S = 0.01
GOAL = GoalPose(0.10, 0.0, 0.5)
#: Clear for the cell itself, and not for one next to it.
HELD = 1


class Table:
    """The programs of cells, and cells that report the box as a test says.

    After the end of their program they have none until they get a goal. Those in `missing` miss it.
    If there is a goal, it is the last of its way, and the first program has it.
    """

    def __init__(self, goal=GOAL, **options):
        self.program = CellsProgram(LAYOUT, (BOX,), CellsMotion(**options))
        self.followed = None
        if goal is not None:
            self.followed = self.program.lead("box", goal, last=True)
            sending = self.program._sendings["box"]
            sending.way = sending.latest
            sending.want(None)
        self.now_s = 0.0
        self.notices = []
        self.ended = False
        self.missing = ()

    def run(self, duration_s, poses=AT, reports=None, elsewhere=(), **believed):
        """The pages sent meanwhile, as (time [s], page); these cells have the box 0.1 m beside."""
        sent = []
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            for cell, estimate in (reports or {}).items():
                pose = poses.get("box", AT["box"]) + np.array([0.1 * (cell in elsewhere), 0, 0])
                seen = seen_from(cell, pose, estimate)
                if self.ended and cell not in self.missing:
                    seen = seen._replace(sequence=0)
                self.program.on_estimate(cell, seen, self.now_s)
            pages = self.program.step(beliefs(poses, [BOX], **believed), self.now_s, STEP_S)
            sent += [(self.now_s, page) for page in pages]
            for page in pages:
                if isinstance(page, messages.End | messages.Goal):
                    self.ended = isinstance(page, messages.End)
            self.notices += self.program.take_notices()
        return sent


def estimate(**fields):
    usual = {"x": 0, "y": 0, "yaw": 0, "identity": 1, "state": wire.UNDER, "wants": 0}
    usual |= {"certainty": 9, "hold": HELD, "sequence": 1, "flags": 0}
    return messages.Estimate(**usual | fields)


def seen_from(cell, pose, estimate):
    """The same estimate with the box at a pose."""
    x_m, y_m = pose[:2] - LAYOUT.cell_positions_m[cell - 1]
    steps = round(x_m / 25e-5), round(y_m / 25e-5), round(pose[2] * 2048 / np.pi)
    return estimate._replace(x=steps[0], y=steps[1], yaw=steps[2])


def reports(cells=range(1, 19), **fields):
    return dict.fromkeys(cells, estimate(**fields))
