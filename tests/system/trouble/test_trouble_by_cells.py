"""Something breaks under a box that its cells steer: the rows of the table in docs/faults.md.

`python -m tests.benchmarks trouble_by_cells` tries all rows, at any instant.
"""

import re
from dataclasses import replace
from math import hypot

import pytest
from tests.system.trouble.documented import messages
from tests.system.trouble.rows_by_cells import GOAL, HEADING, ROWS, STANDS_M_S, Row, run_row


@pytest.mark.parametrize(
    "row", [row for row in ROWS if row.always], ids=lambda row: row.what.replace(" ", "-")
)
def test_run_ends_as_it_should_and_the_fault_is_reported(row: Row) -> None:
    ended = run_row(row, seed=row.seed)
    assert ended.ends is row.ends
    assert ended.run.pauses in row.pauses
    assert ended.run.lost_cells == row.lost
    for message in messages(HEADING)[row.what]:
        assert re.search(message, ended.texts), f"{message}: {ended.texts}"
    assert ended.moved_m_s < STANDS_M_S
    assert ended.strayed_m_s < STANDS_M_S
    assert not ended.touches


def test_box_that_moved_when_the_host_was_cut_off_is_not_called_arrived_beside_its_goal() -> None:
    (row,) = (row for row in ROWS if row.what == "host cut off for 0.4 s")
    ended = run_row(replace(row, until_s=8.0), start_s=1.785)
    x_m, y_m, _ = ended.run.record.pose[-1, 0]
    assert "box has arrived" in ended.texts
    assert (ended.run.status, ended.run.pauses) == ("reached", 1)
    assert hypot(x_m - GOAL[0], y_m - GOAL[1]) < 0.003


def test_every_row_of_the_table_is_tried() -> None:
    assert [row.what for row in ROWS] == list(messages(HEADING))
