"""The order over cells that those who steer get, should the host be gone by then."""

import numpy as np
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
from mdms_protocol.neighbours import messages

BOXES = Parcel("first", 0.28, 0.28), Parcel("second", 0.28, 0.28)
#: Both are to pass the middle of the table, from the west and from the south.
PLACES = {"first": (-0.38, 0.0, 0.0), "second": (0.06, -0.22, 0.0)}
GOALS = {"first": GoalPose(0.38, 0.0, 0.0), "second": GoalPose(0.0, 0.22, 0.0)}
STEP_S = 0.01


class Crossing:
    """Two boxes on 9 x 6 cells, where they are said to lie."""

    def __init__(self, *, go_on: bool = True) -> None:
        layout = Layout(9, 6)
        self.cells = CellsProgram(layout, BOXES, CellsMotion(go_on=go_on))
        loads = {box.name: Load(box.footprint, uniform_mass(box.footprint)) for box in BOXES}
        self.traffic = CellsTraffic(layout, VirtualExecutor(), loads, self.cells)
        self.places = {**PLACES}
        self.now_s = 0.0

    def give(self) -> None:
        for name, goal in GOALS.items():
            self.traffic.give(Order(name, goal))

    def run(self, duration_s: float) -> list[messages.Precedence]:
        """The orders that are sent meanwhile."""
        found = []
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            poses = {name: np.array(place) for name, place in self.places.items()}
            there = beliefs(poses, BOXES)
            self.traffic.step(there, STEP_S)
            pages = self.cells.step(there, self.now_s, STEP_S)
            found += [page for page in pages if isinstance(page, messages.Precedence)]
        return found


def latest(pages: list[messages.Precedence]) -> dict[tuple[int, int], tuple[int, ...]]:
    return {(page.column, page.row): page.identities for page in pages}


def test_cells_that_both_come_over_get_the_order_that_is_planned() -> None:
    crossing = Crossing()
    crossing.give()
    orders = latest(crossing.run(2.0))
    assert orders
    plan = crossing.traffic.plan
    assert plan is not None
    for (column, row), identities in orders.items():
        centre_m = (column - 5) * 0.127, (row - 3.5) * 0.127
        enters_s = {}
        for number, box in enumerate(BOXES, 1):
            route = plan.routes[box.name]
            away_m = np.hypot(*(route.poses[:, :2] - centre_m).T)
            assert away_m.min() < 0.5
            visits = route.visits
            tile = (row - 1 + 1) * 11 + column
            enters_s[number] = visits.enters_s[visits.tile == tile].min()
        assert sorted(identities, key=enters_s.__getitem__) == list(identities)
        assert {*identities} == {1, 2}


def test_each_cell_gets_its_order_again_and_again_with_the_same_number() -> None:
    crossing = Crossing()
    crossing.give()
    crossing.run(1.0)
    pages = crossing.run(4.0)
    cells = {(page.column, page.row) for page in pages}
    assert len(pages) > 2 * len(cells)
    assert len({*pages}) == len(cells)


def test_nothing_is_sent_where_cells_stop_without_the_host() -> None:
    crossing = Crossing(go_on=False)
    crossing.give()
    assert not crossing.run(2.0)


def test_parcel_that_has_passed_is_in_no_order_any_more() -> None:
    crossing = Crossing()
    crossing.give()
    before = latest(crossing.run(2.0))
    crossing.places["first"] = (0.38, 0.0, 0.0)
    after = latest(crossing.run(2.0))
    assert before.keys() == after.keys()
    assert not any(after.values())


def test_orders_end_when_parcels_are_to_stop() -> None:
    crossing = Crossing()
    crossing.give()
    before = latest(crossing.run(2.0))
    crossing.traffic.stop()
    after = latest(crossing.run(2.0))
    assert before.keys() == after.keys()
    assert not any(after.values())
