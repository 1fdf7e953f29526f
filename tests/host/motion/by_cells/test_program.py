"""What the host sends to cells that steer, and what it makes of what they report."""

import numpy as np
import pytest
from tests.host.motion.believing import beliefs

from mdms_host.estimation.pose.confirmation import Standing
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.goal import Goal
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages

LAYOUT = Layout(6, 3)
BOX = Parcel("box", 0.36, 0.30)
AT = {"box": np.array([-0.10, 0.0, 0.0])}
THERE = {"box": np.array([0.10, 0.0, 0.5])}
#: The cells with a sensor well under the box at its start.
UNDER = (2, 3, 4, 8, 9, 10, 14, 15, 16)
STEP_S = 0.01
GOAL = Goal(0.10, 0.0, 0.5)
#: Clear for the cell itself, and not for one next to it.
HELD = 1


class Table:
    """A program, and cells that report what they are to; where the box lies they find by it."""

    def __init__(self, goal=GOAL, **options):
        goals = {} if goal is None else {"box": goal}
        self.program = CellsProgram(LAYOUT, (BOX,), goals, **options)
        self.now_s = 0.0
        self.notices = []

    def run(self, duration_s, poses=AT, reports=None, elsewhere=(), **believed):
        """The pages sent meanwhile, as (time [s], page); these cells have the box 0.1 m beside."""
        sent = []
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            for cell, estimate in (reports or {}).items():
                pose = poses.get("box", AT["box"]) + np.array([0.1 * (cell in elsewhere), 0, 0])
                self.program.on_estimate(cell, seen_from(cell, pose, estimate), self.now_s)
            pages = self.program.step(beliefs(poses, [BOX], **believed), self.now_s, STEP_S)
            sent += [(self.now_s, page) for page in pages]
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


def test_pages_are_what_parcel_and_goal_are():
    (_, parcel), (_, place), (_, goal) = Table(go_on=True).run(STEP_S)
    assert parcel == messages.Parcel(1, 1, wire.RECTANGLE, 1440, 1200, 44, 20, wire.GO_ON)
    assert place == messages.Place(1, 1, -400, 0, 0)
    assert goal == messages.Goal(1, 1, 400, 0, 326, 0, 0)


def test_yaw_at_the_goal_does_not_matter_where_none_is_given():
    pages = Table(Goal(0.1, 0.0, None)).run(STEP_S)
    assert pages[0][1].flags == wire.ANY_YAW
    assert pages[2][1].yaw == 0


def test_nothing_is_sent_for_a_parcel_that_is_not_found():
    assert not Table().run(1.0, poses={})


def test_pages_are_repeated_until_all_cells_of_the_parcel_have_acknowledged_them():
    table = Table()
    assert len(table.run(0.5)) == 3 * 10
    # One of its cells has them still to get.
    assert table.run(0.2, reports=reports(without(UNDER, 9)))
    assert not table.run(1.0, reports=reports(UNDER))
    assert not table.notices


def without(cells, missing):
    return [cell for cell in cells if cell != missing]


def test_a_cell_that_never_answers_is_named_and_does_not_hold_up_the_rest():
    table = Table()
    rest = reports(without(range(1, 19), 9))
    table.run(2.0, reports=rest)
    assert table.notices == ["cell 9 under box: no answer to its program"]
    assert not table.run(1.0, reports=rest)


def test_repeated_pages_have_the_place_where_the_parcel_is_by_then():
    table = Table()
    table.run(0.2)
    places = [page for _, page in table.run(0.1, poses=THERE) if isinstance(page, messages.Place)]
    assert {place.x for place in places} == {400}


def test_program_is_sent_again_when_no_cell_has_the_parcel_any_more():
    table = Table()
    table.run(0.5, reports=reports())
    assert not table.run(0.2)
    assert table.run(0.5)
    assert "no cell has box any more: its program is sent again" in table.notices


def test_parcel_has_arrived_when_most_of_its_cells_say_so_and_the_host_agrees():
    table = Table()
    arrived = reports(UNDER[:5], flags=wire.ARRIVED) | reports(UNDER[5:])
    table.run(0.5, poses=AT, reports=arrived)
    assert not table.program.finished
    table.run(0.5, poses=THERE, reports=reports(UNDER))
    assert not table.program.finished
    table.run(0.5, poses=THERE, reports=arrived)
    assert table.program.finished


def test_cells_without_a_pose_of_the_parcel_have_no_say_in_its_arrival():
    table = Table()
    arrived = reports(UNDER[:4], flags=wire.ARRIVED) | reports(UNDER[4:], certainty=0)
    table.run(0.5, poses=THERE, reports=arrived)
    assert table.program.finished
    table.run(0.5, poses=THERE, reports=reports(UNDER, flags=wire.ARRIVED, certainty=0))
    assert not table.program.finished


def test_cells_that_take_the_parcel_for_arrived_elsewhere_are_contradicted_once():
    table, beside = Table(), {"box": THERE["box"] - (0.03, 0.0, 0.0)}
    table.run(3.0, poses=beside, reports=reports(flags=wire.ARRIVED))
    (notice,) = table.notices
    assert notice.startswith("the cells report box at its goal, but it is believed 30.0 mm and")


def test_cells_that_have_a_parcel_elsewhere_drop_it_and_get_it_where_it_is():
    table, wrong = Table(), (9, 10)
    table.run(0.2, reports=reports(UNDER))
    assert not table.run(0.09, reports=reports(UNDER), elsewhere=wrong)
    sent = [page for _, page in table.run(0.03, reports=reports(UNDER), elsewhere=wrong)]
    assert sent == [messages.End(1, 1)] * 2
    assert table.notices == ["cells 9, 10 have box elsewhere: its program is sent again"]
    # They have dropped it, and some get it again before others.
    sent = [page for _, page in table.run(0.1)]
    assert sent[0] == messages.End(1, 1)
    assert sent[1:4] == [page for _, page in Table().run(STEP_S)]
    assert not table.run(1.0, reports=reports(UNDER))[4:]
    assert len(table.notices) == 1


def test_cells_are_not_contradicted_by_a_host_that_is_not_sure_itself():
    table = Table()
    table.run(0.2, reports=reports(UNDER))
    doubtful = {"standing": Standing.DOUBTFUL}
    assert not table.run(0.5, reports=reports(UNDER), elsewhere=UNDER, **doubtful)


def test_box_that_is_held_is_reported_with_who_wants_whom():
    table = Table()
    east = 1
    table.run(0.5, reports=reports(UNDER))
    held = reports(UNDER) | reports((10,), hold=0, wants=east)
    table.run(3.0, reports=held)
    assert table.notices == ["box is blocked: cell 10 want the way ahead and lack cell 11"]
    assert not table.program.controllers["box"].stopped


def test_standstill_against_the_plan_stops_the_parcel_within_a_second():
    table = Table()
    table.run(0.1, reports=reports())
    sent = table.run(1.0, reports=reports(hold=wire.HOLD_NONE))
    assert table.notices == ["box does not move as its cells command: stopped"]
    assert {page for _, page in sent} == {messages.End(1, 1)}
    assert not table.run(1.0, reports={})


def test_parcel_without_a_goal_gets_an_identity_and_no_goal():
    table = Table(None)
    pages = [page for _, page in table.run(STEP_S)]
    assert [type(page) for page in pages] == [messages.Parcel, messages.Place]
    assert not table.run(1.0, reports=reports(sequence=0, flags=wire.LACKING))


def test_all_programs_are_ended():
    assert Table().program.ends() == [messages.End(1, 1)]


@pytest.mark.parametrize("age_s", [0.03, 0.1])
def test_what_a_cell_reported_long_ago_counts_for_nothing(age_s):
    table = Table()
    table.run(0.5, poses=THERE, reports=reports(flags=wire.ARRIVED))
    assert table.program.finished
    table.run(age_s, poses=THERE)
    assert table.program.finished == (age_s < 0.05)


def test_new_goal_is_a_program_of_the_next_sequence_number():
    table = Table()
    table.run(0.2, reports=reports())
    table.program.set_goal("box", Goal(0.0, 0.0, 0.0))
    sent = table.run(STEP_S, reports=reports())
    assert [page.sequence for _, page in sent] == [2, 2, 2]
    assert sent[-1][1] == messages.Goal(1, 2, 0, 0, 0, 0, 0)
    table.run(0.1, reports=reports(sequence=2))
    assert table.run(0.1, reports=reports(sequence=2)) == []
    assert [page.sequence for page in table.program.ends()] == [2]


def test_goals_that_follow_each_other_faster_than_cells_take_them_are_left_out():
    table = Table()
    table.run(0.2, reports=reports())
    sent = []
    for number in range(8):
        table.program.set_goal("box", Goal(0.01 * number, 0.0, 0.0))
        sent += table.run(2 * STEP_S, reports=reports())
    assert {page.sequence for _, page in sent} == {2}
    sent = table.run(0.3, reports=reports(sequence=2))
    assert {page.sequence for _, page in sent} == {3}
    assert sent[-1][1] == messages.Goal(1, 3, 280, 0, 0, 0, 0)


def test_parcel_that_was_stopped_for_good_goes_on_with_a_new_goal():
    table = Table()
    table.run(3.0, reports=reports(hold=wire.HOLD_NONE))
    assert table.program.stuck
    table.program.set_goal("box", Goal(0.0, 0.0, 0.0))
    assert table.program.stuck is None
    assert table.run(STEP_S, reports=reports(cells=()))[-1][1] == messages.Goal(1, 2, 0, 0, 0, 0, 0)


def test_a_program_that_is_ended_is_ended_often_enough_and_the_parcel_keeps_its_identity():
    table = Table()
    table.run(0.2, reports=reports())
    table.program.end("box")
    sent = [page for _, page in table.run(3 * STEP_S, reports=reports())]
    assert sent == [messages.End(1, 1)] * 3
    sent = [type(page) for _, page in table.run(STEP_S)]
    assert sent == [messages.Parcel, messages.Place]
    assert not table.program.controllers
    assert not table.notices


#: Three goals of one way, and what cells get of the last two of them.
WAY = (Goal(0.0, 0.0, 0.0), Goal(0.1, 0.0, 0.0), Goal(0.1, 0.2, 0.5))


def led(way=WAY, **options):
    """A box that is led along a way."""
    table = Table(None, go_on=True, **options)
    table.program.lead("box", way[0], way[1:])
    return table


def goals(sent):
    """Leg and legs of all pages that have a goal."""
    return [(page.leg, page.legs) for _, page in sent if isinstance(page, messages.Goal)]


def test_legs_are_sent_one_by_one_until_all_cells_have_them():
    table = led()
    lacking = reports(UNDER, sequence=2, flags=wire.LACKING)
    sent = table.run(0.1, reports=lacking)
    assert set(goals(sent)) == {(0, 2), (1, 2), (2, 2)}
    # At most three pages in 50 ms besides those of a program without legs.
    assert len(sent) <= 2 * (3 + 3)
    (ends,) = {page for _, page in sent if isinstance(page, messages.Goal) and page.leg == 2}
    assert ends == messages.Goal(1, 2, 400, 800, 326, 2, 2)
    assert table.run(0.3, reports=lacking)
    assert not table.run(1.0, reports=reports(UNDER, sequence=2))
    assert not table.notices


def test_no_more_legs_are_sent_than_cells_keep():
    way = [Goal(0.01 * number, 0.0, 0.0) for number in range(12)]
    legs = {leg for leg, _ in goals(led(way).run(0.5))}
    assert legs == {0, *range(1, wire.LEGS_MAX + 1)}


def test_no_leg_is_sent_for_a_parcel_that_stops_with_the_host():
    table = Table(None)
    table.program.lead("box", WAY[0], WAY[1:])
    assert set(goals(table.run(0.5))) == {(0, 0)}


def test_goal_that_is_the_next_of_the_way_joins_it_and_another_does_not():
    table = led()
    table.run(0.1, reports=reports(UNDER, sequence=2))
    table.program.lead("box", WAY[1], WAY[2:])
    assert goals(table.run(STEP_S, reports=reports(UNDER, sequence=2))) == [(wire.JOINS, 1)]
    table.run(0.1, reports=reports(UNDER, sequence=3))
    table.program.lead("box", WAY[0], WAY[1:])
    assert goals(table.run(STEP_S, reports=reports(UNDER, sequence=3))) == [(0, 2)]


def test_goal_on_the_way_to_the_next_one_joins_only_if_all_legs_are_the_same():
    for legs, leg in ((WAY[1:], wire.JOINS), ((WAY[2], WAY[1]), 0), (WAY[2:], 0)):
        table = led()
        table.run(0.1, reports=reports(UNDER, sequence=2))
        table.program.lead("box", Goal(0.05, 0.0, 0.0), legs)
        assert goals(table.run(STEP_S, reports=reports(UNDER, sequence=2)))[0] == (leg, len(legs))


def test_cells_that_have_gone_on_by_themselves_are_not_sent_back():
    table = led()
    table.run(0.1, reports=reports(UNDER, sequence=2))
    followed = table.program.controllers["box"]
    assert not table.run(0.5, reports=reports(UNDER, sequence=3))
    assert followed.overtaken
    assert followed.goal == WAY[1]
    table.program.lead("box", WAY[2])
    (first, *_) = goals(table.run(0.1, reports=reports(UNDER, sequence=3)))
    assert first == (0, 0)
    assert table.program.ends() == [messages.End(1, 1)]


def test_box_that_would_tip_gets_a_corner_before_its_goal():
    small = Parcel("box", 0.28, 0.22)
    start, goal = np.array([0.14, -0.008, 0.3]), Goal(-0.08, -0.026, -0.8)
    program = CellsProgram(LAYOUT, (small,), {"box": goal})
    places, pose, now_s = [], start, 0.0
    for _ in range(200):
        now_s += STEP_S
        sequence = places[-1].sequence if places else 1
        for cell in range(1, 19):
            program.on_estimate(cell, estimate(sequence=sequence, hold=wire.HOLD_NONE), now_s)
        for page in program.step(beliefs({"box": pose}, [small]), now_s, STEP_S):
            if isinstance(page, messages.Goal):
                pose = np.array([page.x, page.y, page.yaw * np.pi / 2048]) * (25e-5, 25e-5, 1.0)
                places.append(page)
    corner, last = dict.fromkeys(places)
    assert corner.sequence + 1 == last.sequence
    assert (last.x, last.y) == (-320, -104)


def test_box_is_not_called_arrived_where_a_turn_would_show_its_place_better():
    table = Table()
    arrived = reports(flags=wire.ARRIVED)
    table.run(0.2, poses=THERE, reports=reports())
    (turned, *_) = [
        page
        for _, page in table.run(0.1, poses=THERE, reports=arrived, feel_rad=0.2)
        if isinstance(page, messages.Goal)
    ]
    assert not table.program.finished
    assert turned.yaw == round((0.5 + 0.2) * 2048 / np.pi)
    arrived = reports(flags=wire.ARRIVED, sequence=3)
    table.run(1.0, poses=THERE, reports=arrived)
    assert table.program.finished


@pytest.mark.parametrize(("other_x_m", "corners"), [(0.26, 0), (0.70, 2)])
def test_box_that_might_tip_beside_its_way_leaves_it_only_where_no_other_is_near(
    other_x_m, corners
):
    small, other = Parcel("box", 0.28, 0.22), Parcel("other", 0.28, 0.28)
    poses = {"box": np.array([-0.13, 0.03, -0.99]), "other": np.array([other_x_m, 0.0, 0.0])}
    program = CellsProgram(LAYOUT, (small, other), {"box": Goal(-0.01, 0.02, 0.26)}, go_on=True)
    sent = []
    for beat in range(30):
        sent += program.step(beliefs(poses, [small, other]), beat * STEP_S, STEP_S)
    legs = {page.legs for page in sent if isinstance(page, messages.Goal)}
    assert legs == {corners}
