"""Routes for parcels whose cells steer, when the host has been away for a while."""

import numpy as np
import pytest
from tests.host.motion.believing import beliefs

from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.by_cells.sending import CellsMotion
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.trajectory.pushes import uniform_mass
from mdms_host.programs.order import Order
from mdms_host.programs.traffic.by_cells import CellsTraffic
from mdms_host.programs.traffic.dispatch import VirtualExecutor
from mdms_host.programs.traffic.ride import Load
from mdms_host.routes.improving import legs_of
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages

BOX = Parcel("box", 0.28, 0.28)
START, GOAL = (-0.22, 0.08), GoalPose(0.22, 0.08, 0.0)
STEP_S = 0.01


class Away:
    """A box on 7 x 4 cells, whose way leads around a dead cell, in three legs."""

    def __init__(self):
        layout = Layout(7, 4)
        self.cells = CellsProgram(layout, (BOX,), CellsMotion(go_on=True))
        loads = {"box": Load(BOX.footprint, uniform_mass(BOX.footprint))}
        self.traffic = CellsTraffic(layout, VirtualExecutor(), loads, self.cells)
        self.traffic.on_lost_cells(frozenset({25}))
        self.now_s = 0.0
        self.sequence = 0

    def run(self, duration_s, x_m, y_m):
        """The pages with goals that are sent while the box lies there; all cells have the last."""
        found = []
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            usual = (0, 0, 0, 1, wire.UNDER, 0, 9, wire.HOLD_NONE, self.sequence, 0)
            for cell in range(1, 29):
                self.cells.on_estimate(cell, messages.Estimate(*usual), self.now_s)
            there = beliefs({"box": np.array([x_m, y_m, 0.0])}, [BOX])
            self.traffic.step(there, STEP_S)
            pages = self.cells.step(there, self.now_s, STEP_S)
            goals = [page for page in pages if isinstance(page, messages.Goal)]
            self.sequence = goals[-1].sequence if goals else self.sequence
            found += goals
        return found


def test_parcel_that_went_on_without_the_host_is_planned_anew_and_not_sent_back():
    away = Away()
    away.traffic.give(Order("box", GOAL))
    first = away.run(0.3, *START)[-1]
    assert (first.legs, first.y < 0) == (2, True)
    # The host was gone, and its cells are on the second leg; all has been held since.
    away.traffic.begin_again()
    here_m = 0.07
    again = away.run(0.3, here_m, -0.0635)
    assert again
    assert all(page.x * wire.STEP_UM / 1e6 > here_m - 0.02 for page in again)
    assert again[-1].legs >= 1


def test_an_order_is_done_only_when_a_turn_has_shown_the_place():
    box, goal = Parcel("box", 0.36, 0.30), GoalPose(0.0, 0.0, 0.0)
    layout = Layout(6, 3)
    cells = CellsProgram(layout, (box,))
    loads = {"box": Load(box.footprint, uniform_mass(box.footprint))}
    traffic = CellsTraffic(layout, VirtualExecutor(), loads, cells)
    order = Order("box", goal)
    traffic.give(order)
    now_s, latest, asked = 0.0, None, []

    def run(duration_s, yaw_rad, **believed):
        nonlocal now_s, latest
        pose = np.array([0.0, 0.0, yaw_rad])
        for _ in range(round(duration_s / STEP_S)):
            now_s += STEP_S
            for cell in range(1, 19):
                x_m, y_m = pose[:2] - layout.cell_positions_m[cell - 1]
                steps = round(x_m / 25e-5), round(y_m / 25e-5), round(yaw_rad * 2048 / np.pi)
                sequence = latest.sequence if latest else 0
                there = latest is not None and abs(latest.yaw - steps[2]) < 2
                had = wire.HOLD_NONE, sequence, wire.ARRIVED * there
                cells.on_estimate(cell, messages.Estimate(*steps, 1, wire.UNDER, 0, 9, *had), now_s)
            asked.append("box" in traffic.near)
            feel = believed if asked[-1] else {}
            found = beliefs({"box": pose}, [box], **feel)
            traffic.step(found, STEP_S)
            for page in cells.step(found, now_s, STEP_S):
                latest = page if isinstance(page, messages.Goal) else latest
        return latest.yaw * np.pi / 2048

    assert run(1.0, 0.0, feel=(np.array([0.0, 0.0, 0.2]),)) == pytest.approx(0.2, abs=1e-3)
    assert any(asked)
    assert not order.done
    assert run(1.0, 0.2) == pytest.approx(0.0, abs=1e-3)
    assert not order.done
    run(1.0, 0.0)
    assert order.done


def test_a_way_for_cells_has_no_more_legs_than_they_are_given():
    disc, box = Parcel("disc", 0.30, 0.30, shape="disc"), Parcel("box", 0.40, 0.30)
    cells = CellsProgram(Layout(9, 6), (disc, box), CellsMotion(go_on=True))
    loads = {each.name: Load(each.footprint, uniform_mass(each.footprint)) for each in (disc, box)}
    traffic = CellsTraffic(Layout(9, 6), VirtualExecutor(), loads, cells)
    traffic.give(Order("disc", GoalPose(-0.2611, -0.2303, None)))
    traffic.give(Order("box", GoalPose(-0.2407, 0.2310, np.pi)))
    # They pass each other, and the box turns on its way where it has room.
    places = {"disc": (0.2573, 0.2303, 1.5708), "box": (0.2686, -0.2310, 0.0)}
    there = beliefs({name: np.array(place) for name, place in places.items()}, [disc, box])
    for _ in range(10):
        traffic.step(there, STEP_S)
    routes = traffic.plan.routes
    assert 1 < legs_of(routes["box"]) <= wire.LEGS_MAX
    assert np.allclose(routes["box"].poses[-1][:2], (-0.2407, 0.2310))


def plan_of(box: Parcel, start: np.ndarray, goal: GoalPose, *, lost=(), go_on=False, hangs=False):
    """The order for a box on 6 x 3 cells, of which some are lost, after a plan was asked for."""
    layout = Layout(6, 3)
    cells = CellsProgram(layout, (box,), CellsMotion(go_on=go_on))
    loads = {"box": Load(box.footprint, uniform_mass(box.footprint))}
    traffic = CellsTraffic(layout, VirtualExecutor(), loads, cells, hangs=hangs)
    traffic.on_lost_cells(frozenset(lost))
    order = Order("box", goal)
    traffic.give(order)
    for _ in range(600):
        traffic.step(beliefs({"box": start}, [box]), 0.01)
    return order, traffic


def test_a_way_leads_over_a_lost_cell_where_there_is_no_other_and_the_host_stays():
    box, start, goal = (
        Parcel("box", 0.28, 0.26),
        np.array([-0.22, 0.0, 0.0]),
        GoalPose(0.22, 0.0, 0.0),
    )
    order, traffic = plan_of(box, start, goal, lost=(10,))
    assert order.refused is None
    assert "box" in traffic.under_way
    order, _ = plan_of(box, start, goal, lost=(10,), go_on=True)
    assert "closed cells" in order.refused


def test_a_goal_of_a_scenario_may_hang_over_the_edge_and_a_place_of_a_program_may_not():
    box, start, goal = (
        Parcel("box", 0.36, 0.30),
        np.array([-0.1, 0.0, 0.0]),
        GoalPose(0.26, 0.0, 0.0),
    )
    order, traffic = plan_of(box, start, goal, hangs=True)
    assert order.refused is None
    assert "box" in traffic.under_way
    order, _ = plan_of(box, start, goal)
    assert order.refused is not None
