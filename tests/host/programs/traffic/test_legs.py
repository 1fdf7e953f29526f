"""A route is sent to cells that steer leg by leg, as far as it is free."""

import numpy as np
import pytest

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Rectangle
from mdms_host.motion.by_cells.followed import Followed
from mdms_host.motion.by_cells.sending import CellsMotion
from mdms_host.motion.goal import GoalPose, Limits
from mdms_host.motion.trajectory.pushes import uniform_mass
from mdms_host.programs.order import Order
from mdms_host.programs.traffic.by_cells import Legs
from mdms_host.programs.traffic.ride import Load
from mdms_host.routes.route import Route, Visits

BOX = Rectangle(0.30, 0.28)
#: East by 0.3 m, then north by 0.2 m.
CORNERED = np.array([(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.3, 0.2, 0.0)])
GOAL = GoalPose(0.3, 0.2, 0.0)
STEP_S = 0.01
#: At 0.4 m/s2.
BRAKING = Limits(friction=0.4, friction_share=1.0, gravity_m_s2=1.0)
NOWHERE = Visits(*(np.zeros(0, dtype=kind) for kind in (np.intp, *[float] * 4)))


class Road:
    """Legs of a box on the cornered route, and the goals that were sent; the box goes by hand."""

    def __init__(self, goes_on=False):
        self.sent = []
        #: The legs that followed the goal that was sent last.
        self.followed_by = []
        self.followed = None
        along_m = np.array([0.0, 0.3, 0.5])
        route = Route("box", CORNERED, along_m, along_m[:2], along_m[1:], NOWHERE, BOX.reach_m)
        load = Load(BOX, uniform_mass(BOX))
        order = Order("box", GOAL)
        self.legs = Legs(order, route, load, self.send, CellsMotion(BRAKING, goes_on))

    def send(self, goal, legs, last):
        self.last = last
        self.sent.append((round(goal.x_m, 3), round(goal.y_m, 3)))
        self.followed_by = [(round(leg.x_m, 3), round(leg.y_m, 3)) for leg in legs]
        self.followed = Followed(goal, Limits(), BOX.reach_m)
        return self.followed

    def at(self, x_m, y_m, limit_m=1.0, speed_m_s=0.0, cycles=1):
        """The goals that are sent while the box is there."""
        before = len(self.sent)
        pose, twist = np.array([x_m, y_m, 0.0]), np.array([speed_m_s, 0.0, 0.0])
        for _ in range(cycles):
            self.legs.step(Belief("box", BOX, pose, twist, np.zeros((3, 3))), STEP_S, limit_m)
        return self.sent[before:]


def test_a_leg_is_sent_when_the_one_before_is_done():
    road = Road()
    assert road.at(0.0, 0.0) == [(0.3, 0.0)]
    assert road.at(0.28, 0.0, cycles=5) == []
    assert not road.last
    assert road.at(0.297, 0.001, cycles=2) == [(0.3, 0.2)]
    assert road.last
    assert not road.legs.has_come
    road.at(0.3, 0.198, cycles=2)
    assert road.legs.has_come
    assert not road.legs.arrived
    road.followed.arrived = True
    assert road.legs.arrived
    assert len(road.sent) == 2


def test_a_box_that_is_felt_beside_its_goal_has_not_left_its_way():
    road = Road()
    road.at(0.0, 0.0)
    road.at(0.3, 0.0)
    road.at(0.3, 0.2)
    road.followed.lead(GoalPose(0.3, 0.26, 0.0))
    assert road.at(0.3, 0.26, cycles=5) == []
    assert not road.legs.off_path
    road.followed.lead(road.followed.goal)
    road.at(0.3, 0.26)
    assert road.legs.off_path


def test_a_box_that_is_felt_is_stopped_where_it_is_and_goes_no_further():
    road = Road()
    road.at(0.0, 0.0)
    road.at(0.3, 0.0)
    road.at(0.3, 0.2)
    road.followed.lead(GoalPose(0.3, 0.26, 0.0))
    road.legs.stopping = True
    assert road.at(0.3, 0.23, speed_m_s=0.05) == [(0.3, 0.23)]
    assert not road.last
    assert road.at(0.3, 0.232, cycles=30) == []
    assert road.legs.at_rest


def test_no_goal_is_sent_before_the_way_is_free_and_parts_of_a_leg_as_it_becomes_so():
    road = Road()
    assert road.at(0.0, 0.0, limit_m=0.0, cycles=3) == []
    assert road.at(0.0, 0.0, limit_m=0.1) == [(0.1, 0.0)]
    assert road.at(0.05, 0.0, limit_m=0.12) == []
    assert road.at(0.05, 0.0, limit_m=0.2) == [(0.2, 0.0)]
    assert road.at(0.1, 0.0, limit_m=0.5) == [(0.3, 0.0)]


def test_a_way_that_is_free_but_for_rounding_is_gone_to_its_end():
    road = Road()
    road.at(0.0, 0.0, limit_m=0.5 - 1e-12)
    road.at(0.297, 0.0, limit_m=0.5 - 1e-12)
    assert road.sent[-1] == (0.3, 0.2)
    road.at(0.3, 0.199, limit_m=0.5 - 1e-12, cycles=2)
    assert road.legs.has_come


def test_a_way_that_is_taken_back_is_stopped_on_where_the_parcel_can():
    road = Road()
    road.at(0.0, 0.0)
    assert road.at(0.1, 0.0, limit_m=0.05, speed_m_s=0.2) == [(0.15, 0.0)]


def test_one_that_is_to_stop_does_so_and_rests():
    road = Road()
    road.at(0.0, 0.0)
    road.legs.stopping = True
    assert road.at(0.1, 0.0, speed_m_s=0.2) == [(0.15, 0.0)]
    assert not road.legs.at_rest
    road.at(0.15, 0.0, cycles=30)
    assert road.legs.at_rest
    assert len(road.sent) == 2


def test_one_beside_its_route_needs_another():
    road = Road()
    road.at(0.0, 0.0)
    road.at(0.1, 0.02)
    assert not road.legs.off_path
    road.at(0.1, 0.05)
    assert road.legs.off_path


def test_one_that_its_cells_do_not_move_stands():
    road = Road()
    road.at(0.0, 0.0)
    road.followed.stopped = True
    assert road.legs.stands
    assert road.at(0.297, 0.0, cycles=3) == []


def test_a_route_without_length_is_a_goal_all_the_same():
    order = Order("box", GoalPose(0.0, 0.0, 0.0))
    alone = np.zeros(1)
    route = Route("box", CORNERED[:1], alone, alone[:0], alone[:0], NOWHERE, BOX.reach_m)
    road = Road()
    road.legs = Legs(order, route, Load(BOX, uniform_mass(BOX)), road.send, CellsMotion(BRAKING))
    assert road.at(0.0, 0.0, limit_m=0.0) == [(0.0, 0.0)]
    assert road.legs.progress_m == pytest.approx(0.0)


def test_legs_that_follow_go_with_a_goal_for_the_time_without_a_host():
    road = Road(goes_on=True)
    assert road.at(0.0, 0.0, limit_m=0.1) == [(0.1, 0.0)]
    assert road.followed_by == [(0.3, 0.0), (0.3, 0.2)]
    assert road.at(0.05, 0.0) == [(0.3, 0.0)]
    assert road.followed_by == [(0.3, 0.2)]
    assert road.at(0.297, 0.0, cycles=3) == [(0.3, 0.2)]
    assert road.followed_by == []


def test_legs_are_taken_back_while_something_is_in_the_way_and_given_again():
    road = Road(goes_on=True)
    road.at(0.0, 0.0)
    road.legs.obstructed = True
    assert road.at(0.05, 0.0, cycles=5) == [(0.3, 0.0)]
    assert road.followed_by == []
    road.legs.obstructed = False
    assert road.at(0.05, 0.0, cycles=5) == [(0.3, 0.0)]
    assert road.followed_by == [(0.3, 0.2)]


def test_one_that_is_to_stop_goes_along_no_leg():
    road = Road(goes_on=True)
    road.at(0.0, 0.0)
    road.legs.stopping = True
    road.at(0.296, 0.0, speed_m_s=0.2, cycles=5)
    assert road.followed_by == []


def test_one_whose_cells_have_gone_on_by_themselves_goes_on_from_there():
    road = Road(goes_on=True)
    road.at(0.0, 0.0)
    road.followed.overtaken = True
    assert road.at(0.3, 0.1, cycles=3) == []
    assert road.legs.progress_m == pytest.approx(0.4)
    assert not road.legs.off_path


def test_half_a_turn_is_sent_as_two_quarters_so_that_cells_turn_as_is_planned():
    turned = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, np.pi)])
    along_m = np.array([0.0, np.pi * BOX.reach_m])
    route = Route("box", turned, along_m, along_m[:1], along_m[1:], NOWHERE, BOX.reach_m)
    sent = []

    def send(goal, legs, _last):
        sent.append([goal.yaw_rad, *(leg.yaw_rad for leg in legs)])
        return Followed(goal, Limits(), BOX.reach_m)

    order = Order("box", GoalPose(0.0, 0.0, np.pi))
    legs = Legs(order, route, Load(BOX, uniform_mass(BOX)), send, CellsMotion(BRAKING, go_on=True))
    for yaw_rad in (0.0, 0.1, np.pi / 2, np.pi / 2):
        pose = np.array([0.0, 0.0, yaw_rad])
        legs.step(Belief("box", BOX, pose, np.zeros(3), np.zeros((3, 3))), STEP_S, 10.0)
    assert sent == [pytest.approx([np.pi / 2, np.pi]), pytest.approx([np.pi])]
