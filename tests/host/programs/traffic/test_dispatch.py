"""Plans are asked for around all that rides, and give those that stopped their ways again."""

import numpy as np
import pytest
from tests.host.programs.traffic.test_legs import BOX

from mdms_host.estimation.footprint import Rectangle
from mdms_host.layout import Layout
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.trajectory.pushes import uniform_mass
from mdms_host.programs.order import Gate, Order
from mdms_host.programs.traffic.dispatch import DELAY_CYCLES, Dispatch, VirtualExecutor, WayRules
from mdms_host.programs.traffic.ride import Load
from mdms_host.programs.traffic.world_state import Timetable, WorldState
from mdms_host.routes.grid import Tiles
from mdms_host.routes.planner import Planner
from mdms_host.routes.planning_problem import RouteTask
from mdms_host.routes.support import Shape

LOAD = Load(BOX, uniform_mass(BOX))
#: Cells from south to north in the middle of 15 x 8, but for three.
WALL = [row * 15 + 8 for row in (0, 1, 2, 6, 7)]


def taken(dispatch):
    """The parcels that have a route by the plan that has been asked for."""
    for _ in range(DELAY_CYCLES):
        routes = {order.parcel for order, _ in dispatch.take()}
    return routes


def test_newcomer_is_planned_with_its_own_shape_under_the_name_of_one_that_has_left():
    planner = Planner(Tiles(Layout(6, 6)))
    small, large = Rectangle(0.16, 0.16), Rectangle(0.40, 0.30)
    loads = {"box": Load(small, uniform_mass(small))}
    where = WorldState(loads, planner.stand)
    where.places = {"box": np.zeros(3)}
    before = len(where.under()["box"])
    where.drop("box")
    loads["box"] = Load(large, uniform_mass(large))
    where.places = {"box": np.zeros(3)}
    assert len(where.under()["box"]) > 2 * before


def test_a_parcel_stopped_before_a_gap_passes_it_before_another_comes_to_stay_there():
    planner = Planner(Tiles(Layout(15, 8)))
    loads = dict.fromkeys(("far", "near"), LOAD)
    where, timetable = WorldState(loads, planner.stand), Timetable()
    where.places = {"far": np.array([-0.7, -0.3, 0.0]), "near": np.array([-0.5, 0.35, 0.0])}
    rules = WayRules(over_lost=False)
    dispatch = Dispatch(planner, VirtualExecutor(), where, timetable, rules)
    dispatch.close(WALL)
    far = Order("far", GoalPose(0.6, 0.06, 0.0))
    dispatch.ask({"far": far, "near": Order("near", GoalPose(0.0, 0.06, 0.0))}, {}, 0.0)
    assert taken(dispatch) == {"far", "near"}
    dispatch.ask({"far": far}, {"near": 0.0}, 0.0)
    assert taken(dispatch) == {"far"}


def test_a_parcel_that_stands_30_mm_from_its_planned_place_is_in_the_way():
    timetable = Timetable()
    start, goal = np.zeros(3), np.array([0.05, 0.0, 0.0])
    timetable.begin(Planner(Tiles(Layout(6, 6))).plan([RouteTask("box", Shape(BOX), start, goal)]))
    assert timetable.has_at("box", np.array([0.015, 0.02, 0.0]))
    assert not timetable.has_at("box", np.array([0.025, 0.025, 0.0]))


def test_a_parcel_goes_up_to_a_thing_on_its_way_and_not_onto_a_tile_of_it():
    planner = Planner(Tiles(Layout(9, 6)))
    shape, start, goal = Shape(BOX), np.array([-0.35, 0.0, 0.0]), np.array([0.35, 0.0, 0.0])
    route = planner.plan([RouteTask("box", shape, start, goal)]).routes["box"]
    where = WorldState(dict.fromkeys(("box", "thing"), LOAD), planner.stand)
    where.places = {"box": start, "thing": np.array([0.2, 0.02, 0.3])}
    where.find_obstacles(lambda name, place: name == "box")
    free_m = where.free_m("box", route, 0.0)
    thing = set(planner.stand(shape, where.places["thing"]).tolist())
    assert thing.isdisjoint(planner.stand(shape, route.pose_at(free_m)).tolist())
    assert not thing.isdisjoint(planner.stand(shape, route.pose_at(free_m + 0.02)).tolist())


def test_one_on_the_edge_of_its_exit_goes_on_outward_and_not_back_towards_one_beside_it():
    planner = Planner(Tiles(Layout(15, 8)))
    loads = dict.fromkeys(("out", "beside"), LOAD)
    where = WorldState(loads, planner.stand)
    north = Gate("north", (1, 1), 0.4445, -0.6, 0.6)
    where.places = {"out": np.array([0.0, 0.445, 0.0]), "beside": np.array([0.0, 0.157, 0.0])}
    dispatch = Dispatch(planner, VirtualExecutor(), where, Timetable(), WayRules())
    dispatch.ask({"out": Order("out", north)}, {}, 0.0)
    assert taken(dispatch) == {"out"}


@pytest.mark.parametrize(("columns", "blocked"), [((8,), False), ((7, 8, 9, 10), True)])
def test_a_way_leads_over_lost_cells_only_where_enough_others_brake(columns, blocked):
    planner = Planner(Tiles(Layout(15, 4)))
    loads = {"box": LOAD}
    where = WorldState(loads, planner.stand)
    where.places = {"box": np.array([-0.6, 0.0, 0.0])}
    dispatch = Dispatch(planner, VirtualExecutor(), where, Timetable(), WayRules())
    dispatch.close([row * 15 + column for row in range(4) for column in columns])
    dispatch.ask({"box": Order("box", GoalPose(0.6, 0.0, 0.0))}, {}, 0.0)
    assert (taken(dispatch) == set()) is blocked
    assert [
        no_way.text.endswith("reached around them") for no_way in dispatch.blocked.values()
    ] == [True] * blocked


def test_a_parcel_on_lost_cells_is_led_off_them():
    planner = Planner(Tiles(Layout(15, 4)))
    loads = {"box": LOAD}
    where = WorldState(loads, planner.stand)
    where.places = {"box": np.array([0.0, 0.0, 0.0])}
    dispatch = Dispatch(planner, VirtualExecutor(), where, Timetable(), WayRules())
    dispatch.close([row * 15 + column for row in range(4) for column in (7, 8)])
    dispatch.ask({"box": Order("box", GoalPose(0.6, 0.0, 0.0))}, {}, 0.0)
    assert taken(dispatch) == {"box"}
