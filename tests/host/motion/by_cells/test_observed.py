"""How the host uses the reports of cells about a parcel."""

import pytest
from tests.host.motion.by_cells.table import (
    AT,
    THERE,
    UNDER,
    Table,
    reports,
)

from mdms_host.estimation.belief import Standing
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages


def test_parcel_has_arrived_when_most_of_its_cells_say_so_and_the_host_agrees():
    table = Table()
    arrived = reports(UNDER[:5], flags=wire.ARRIVED) | reports(UNDER[5:])
    table.run(0.5, poses=AT, reports=arrived)
    assert not table.followed.arrived
    table.run(0.5, poses=THERE, reports=reports(UNDER))
    assert not table.followed.arrived
    table.run(0.5, poses=THERE, reports=arrived)
    assert table.followed.arrived


def test_cells_without_a_pose_of_the_parcel_have_no_say_in_its_arrival():
    table = Table()
    arrived = reports(UNDER[:4], flags=wire.ARRIVED) | reports(UNDER[4:], certainty=0)
    table.run(0.5, poses=THERE, reports=arrived)
    assert table.followed.arrived
    table.run(0.5, poses=THERE, reports=reports(UNDER, flags=wire.ARRIVED, certainty=0))
    assert not table.followed.arrived


def test_cells_that_take_the_parcel_for_arrived_elsewhere_are_contradicted_once():
    table, beside = Table(), {"box": THERE["box"] - (0.03, 0.0, 0.0)}
    table.run(3.0, poses=beside, reports=reports(flags=wire.ARRIVED))
    (notice,) = table.notices
    assert notice.startswith("the cells report box at its goal, but it is believed 30.0 mm and")


def test_cells_are_not_contradicted_by_a_host_that_is_not_sure_itself():
    table = Table()
    table.run(0.2, reports=reports(UNDER))
    doubtful = {"standing": Standing.DOUBTFUL}
    assert not table.run(0.5, reports=reports(UNDER), elsewhere=UNDER, **doubtful)


def test_box_that_is_held_is_reported_with_the_cells_that_it_lacks():
    table = Table()
    east = 1
    table.run(0.5, reports=reports(UNDER))
    held = reports(UNDER) | reports((10,), hold=0, wants=east)
    table.run(3.0, reports=held)
    assert table.notices == ["box is blocked: cell 10 wants the way ahead and lacks cell 11"]
    assert not table.followed.stopped


def test_a_parcel_that_stands_against_the_plan_is_stopped_within_a_second():
    table, standing = Table(), reports(hold=wire.HOLD_NONE)
    table.run(0.1, reports=reports())
    sent = table.run(1.0, reports=standing)
    assert {page for _, page in sent} == {messages.End(1, 1)}
    assert table.followed.stopped
    assert not table.run(1.0, reports={})


@pytest.mark.parametrize("age_s", [0.03, 0.1])
def test_an_old_report_of_a_cell_counts_for_nothing(age_s):
    table = Table()
    table.run(0.5, poses=THERE, reports=reports(flags=wire.ARRIVED))
    assert table.followed.arrived
    table.run(age_s, poses=THERE)
    assert table.followed.arrived == (age_s < 0.05)


def test_cells_that_take_the_parcel_for_arrived_elsewhere_get_it_anew_where_it_is_believed():
    table, beside = Table(), {"box": THERE["box"] - (0.0, 0.0, 0.04)}
    ends, notices = [], []
    for _ in range(7):
        table.run(0.2, poses=beside, reports=reports())
        sent = table.run(0.8, poses=beside, reports=reports(flags=wire.ARRIVED))
        ends.append(sum(isinstance(page, messages.End) for _, page in sent))
        notices.append(len(table.notices))
    assert ends == [3, 3, 3, 3, 3, 0, 0]
    # It is no trouble where it helps.
    assert notices == [0, 1, 1, 1, 1, 1, 1]


@pytest.mark.parametrize(("off", "arrived"), [(0.0029, True), (0.0031, False)])
def test_parcel_has_arrived_within_3_mm_of_its_goal_as_the_host_believes(off, arrived):
    table, beside = Table(), {"box": THERE["box"] - (off, 0.0, 0.0)}
    table.run(0.3, poses=beside, reports=reports(flags=wire.ARRIVED))
    assert table.followed.arrived == arrived
