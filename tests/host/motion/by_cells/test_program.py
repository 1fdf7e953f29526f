"""Where cells are to take parcels, goal by goal."""

import numpy as np
from tests.host.motion.believing import beliefs
from tests.host.motion.by_cells.table import (
    LAYOUT,
    STEP_S,
    THERE,
    Table,
    reports,
)

from mdms_host.estimation.tracker import Parcel
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.by_cells.sending import CellsMotion, CellTurn
from mdms_host.motion.goal import GoalPose
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages


def test_parcel_without_a_goal_gets_an_identity_and_no_goal():
    table = Table(None)
    pages = [page for _, page in table.run(STEP_S)]
    assert [type(page) for page in pages] == [messages.Parcel, messages.Place]
    assert not table.run(1.0, reports=reports(sequence=0, flags=wire.LACKING))


def test_all_programs_are_ended():
    assert Table().program.ends() == [messages.End(1, 1)]


def test_new_goal_is_a_program_of_the_next_sequence_number():
    table = Table()
    table.run(0.2, reports=reports())
    table.program.lead("box", GoalPose(0.0, 0.0, 0.0))
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
        table.program.lead("box", GoalPose(0.01 * number, 0.0, 0.0))
        sent += table.run(2 * STEP_S, reports=reports())
    assert {page.sequence for _, page in sent} == {2}
    sent = table.run(0.3, reports=reports(sequence=2))
    assert {page.sequence for _, page in sent} == {3}
    assert sent[-1][1] == messages.Goal(1, 3, 280, 0, 0, 0, 0)


def test_parcel_that_was_stopped_goes_on_with_a_new_goal():
    table = Table()
    table.run(1.5, reports=reports(hold=wire.HOLD_NONE))
    assert table.followed.stopped
    followed = table.program.lead("box", GoalPose(0.0, 0.0, 0.0))
    assert not followed.stopped
    assert table.run(STEP_S, reports=reports(cells=()))[-1][1] == messages.Goal(1, 2, 0, 0, 0, 0, 0)


def test_box_is_not_called_arrived_where_a_turn_would_show_its_place_better():
    table = Table()
    arrived = reports(flags=wire.ARRIVED)
    table.run(0.2, poses=THERE, reports=reports())
    (turned, *_) = [
        page
        for _, page in table.run(
            0.1, poses=THERE, reports=arrived, feel=(np.array([0.0, 0.0, 0.2]),)
        )
        if isinstance(page, messages.Goal)
    ]
    assert not table.followed.arrived
    assert turned.yaw == round((0.5 + 0.2) * 2048 / np.pi)
    arrived = reports(flags=wire.ARRIVED, sequence=3)
    table.run(1.0, poses=THERE, reports=arrived)
    assert table.followed.arrived


def test_sixty_fourth_newcomer_gets_the_identity_of_one_that_has_left():
    program, now_s, sent = CellsProgram(LAYOUT, ()), 0.0, []
    for number in range(1, 66):
        parcel = Parcel(f"parcel-{number}", 0.28, 0.28)
        program.add(parcel)
        for _ in range(20):
            now_s += STEP_S
            there = beliefs({parcel.name: np.zeros(3)}, [parcel])
            pages = program.step(there, now_s, STEP_S)
            sent += [(number, page) for page in pages]
            for page in pages:
                messages.encode_page(page)
    assert {page.identity for _, page in sent} == set(range(1, 64))
    # Cells lose the parcel that has left before they get the other.
    reused = [page for number, page in sent if number == 64]
    assert [type(page) for page in reused[:4]] == [*[messages.End] * 3, messages.Parcel]
    assert {page.identity for page in reused} == {1}
    assert {page.identity for number, page in sent if number == 65} == {2}


def test_parcel_beyond_those_that_cells_tell_apart_is_not_steered_and_named_until_one_leaves():
    parcels = [Parcel(f"parcel-{number}", 0.2, 0.2) for number in range(1, 65)]
    program, now_s = CellsProgram(LAYOUT, tuple(parcels)), 0.0
    poses = {parcel.name: np.array([0.3 * n, 0.0, 0.0]) for n, parcel in enumerate(parcels)}
    for _ in range(3):
        now_s += STEP_S
        pages = program.step(beliefs(poses, parcels), now_s, STEP_S)
    assert program.take_notices() == ["parcel-64 is not steered: cells tell 63 parcels apart"]
    del poses["parcel-7"]
    for _ in range(10):
        now_s += STEP_S
        pages += program.step(beliefs(poses, parcels), now_s, STEP_S)
    # It comes back, and there is none for it.
    assert {page.identity for page in pages} == set(range(1, 64))


def test_order_leaves_out_a_parcel_beyond_those_that_cells_tell_apart():
    parcels = [Parcel(f"parcel-{number}", 0.2, 0.2) for number in range(1, 65)]
    program = CellsProgram(LAYOUT, tuple(parcels), CellsMotion(go_on=True))
    program.set_turns({3: (CellTurn("parcel-64", 0.0), CellTurn("parcel-2", 1.0))})
    pages = program.step({}, STEP_S, STEP_S)
    assert [page.identities for page in pages] == [(2,)]
