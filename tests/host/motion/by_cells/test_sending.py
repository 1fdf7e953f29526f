"""The frames to the cells of a parcel, and the time until which they are sent."""

import pytest
from tests.host.motion.by_cells.table import (
    BOX,
    STEP_S,
    THERE,
    UNDER,
    Table,
    estimate,
    reports,
)

from mdms_host.motion.by_cells.sending import parcel_page
from mdms_host.motion.goal import GoalPose, Limits
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages


def test_pages_agree_with_parcel_and_goal():
    (_, parcel), (_, place), (_, goal) = Table(go_on=True).run(STEP_S)
    assert parcel == messages.Parcel(1, 1, wire.RECTANGLE, 1440, 1200, 44, 20, wire.GO_ON)
    assert place == messages.Place(1, 1, -400, 0, 0)
    assert goal == messages.Goal(1, 1, 400, 0, 326, 0, 0)


def test_limits_below_a_step_of_the_wire_are_one_step():
    page = parcel_page(1, 1, BOX, Limits(speed_m_s=0.001, friction=0.002), 0)
    assert (page.speed, page.acceleration) == (1, 1)
    assert messages.decode_page(messages.encode_page(page)) == page


def test_limits_above_those_of_the_wire_are_the_greatest_that_it_has():
    page = parcel_page(1, 1, BOX, Limits(speed_m_s=2.0, friction=1.9), 0)
    assert (page.speed, page.acceleration) == (255, 255)
    assert messages.decode_page(messages.encode_page(page)) == page


def test_yaw_at_the_goal_does_not_matter_where_none_is_given():
    pages = Table(GoalPose(0.1, 0.0, None)).run(STEP_S)
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


def test_pages_are_repeated_while_a_cell_at_the_parcel_lacks_the_program():
    for lack in ({"flags": wire.LACKING}, {"sequence": 0, "flags": wire.LACKING}, {"sequence": 3}):
        table = Table()
        table.run(0.5, reports=reports(UNDER))
        lacking = {**reports(UNDER), 11: estimate(state=wire.PROMISED, **lack)}
        # Its neighbours hand it on.
        assert not table.run(0.15, reports=lacking)
        assert len(table.run(1.0, reports=lacking)) >= 3 * 18
        table.run(0.1, reports=reports(UNDER))
        assert not table.run(0.5, reports=reports(UNDER))
        assert not table.notices


def test_cells_at_a_parcel_without_a_goal_lack_nothing():
    table = Table(None)
    there = reports(UNDER, sequence=0, flags=wire.LACKING)
    table.run(0.5, reports=there)
    assert not table.run(1.0, reports=there)


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


def test_program_is_sent_at_once_when_a_parcel_is_found_that_no_cell_has_had_for_long():
    table = Table()
    table.run(0.5, reports=reports())
    assert not any(isinstance(page, messages.Place) for _, page in table.run(0.5, poses={}))
    (first_s, _), *_ = table.run(0.1)
    assert first_s == pytest.approx(1.01)


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


def test_a_program_that_is_ended_is_ended_often_enough_and_the_parcel_keeps_its_identity():
    table = Table()
    table.run(0.2, reports=reports())
    table.program.end("box")
    sent = [page for _, page in table.run(3 * STEP_S, reports=reports())]
    assert sent == [messages.End(1, 1)] * 3
    sent = [type(page) for _, page in table.run(STEP_S)]
    assert sent == [messages.Parcel, messages.Place]
    assert not table.program.near
    assert not table.notices


def test_cells_that_keep_a_promise_after_the_end_get_the_data_of_the_parcel_again():
    table = Table()
    table.run(0.2, reports=reports())
    table.program.end("box")
    promised = reports(state=wire.PROMISED, sequence=0, flags=wire.LACKING)
    table.run(3 * STEP_S, reports=promised)
    sent = [type(page) for _, page in table.run(STEP_S, reports=promised)]
    assert sent == [messages.Parcel, messages.Place]
    table.run(0.1, reports=reports(sequence=0, flags=wire.LACKING))
    assert not table.run(1.0, reports=reports(sequence=0, flags=wire.LACKING))


#: Three goals of one way, and what cells get of the last two of them.
WAY = (GoalPose(0.0, 0.0, 0.0), GoalPose(0.1, 0.0, 0.0), GoalPose(0.1, 0.2, 0.5))


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
    way = [GoalPose(0.01 * number, 0.0, 0.0) for number in range(12)]
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
        table.program.lead("box", GoalPose(0.05, 0.0, 0.0), legs)
        assert goals(table.run(STEP_S, reports=reports(UNDER, sequence=2)))[0] == (leg, len(legs))


def test_cells_that_have_gone_on_by_themselves_are_not_sent_back():
    table = led()
    table.run(0.1, reports=reports(UNDER, sequence=2))
    followed = table.program._followed["box"]
    assert not table.run(0.5, reports=reports(UNDER, sequence=3))
    assert followed.overtaken
    assert followed.goal == WAY[1]
    table.program.lead("box", WAY[2])
    (first, *_) = goals(table.run(0.1, reports=reports(UNDER, sequence=3)))
    assert first == (0, 0)
    assert table.program.ends() == [messages.End(1, 1)]


def test_end_is_sent_again_while_a_cell_goes_on_with_the_program():
    """One wheel would push on, and hand the program to neighbours that know of no end."""
    for poses in (THERE, {}):
        table = Table()
        table.run(0.5, poses=THERE, reports=reports(UNDER))
        table.missing = (9,)
        table.program.end("box")
        table.run(0.1, poses=poses, reports=reports(UNDER))
        sent = table.run(1.0, poses=poses, reports=reports(UNDER))
        assert sum(isinstance(page, messages.End) for _, page in sent) == 5
        table.missing = ()
        table.run(0.1, poses=poses, reports=reports(UNDER))
        sent = table.run(1.0, poses=poses, reports=reports(UNDER))
        assert not [page for _, page in sent if isinstance(page, messages.End)]


def test_end_is_sent_again_to_a_cell_that_drives_a_parcel_that_was_stopped():
    table = Table()
    table.run(2.0, reports=reports(hold=wire.HOLD_NONE))
    assert table.followed.stopped
    table.missing = (9,)
    sent = table.run(1.0, reports=reports(hold=wire.HOLD_NONE))
    assert len(sent) >= 4
    assert {type(page) for _, page in sent} == {messages.End}
