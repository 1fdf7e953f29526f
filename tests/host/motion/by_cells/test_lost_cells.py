"""A lost cell that a box wants: the host's rounds, and the answers of the cells around."""

from itertools import pairwise

import pytest
from tests.host.motion.by_cells.table import STEP_S, Table, reports

from mdms_host.motion.by_cells.lost_cells import LOST_S
from mdms_protocol.neighbours import lost, messages

#: In the middle of the table of 6 x 3, and the cells around it.
LOST, COLUMN, ROW = 9, 3, 2
AROUND = (2, 3, 4, 8, 10, 14, 15, 16)
NEVER = float("inf")


class Lossy(Table):
    """The cells under a box want the lost one among them; some cells answer for it."""

    def __init__(self, answering=AROUND, **options):
        super().__init__(**options)
        self.answering = answering
        self.kind = lost.AGREED
        self.silent_s = NEVER
        self.program.on_lost_cells(frozenset((LOST,)))

    def rounds(self, duration_s, cells=AROUND, wants=0xFF):
        """The pages about lost cells that are sent meanwhile."""
        found = []
        said = reports(cells, wants=wants)
        for _ in range(round(duration_s / STEP_S)):
            self.program.on_silence({LOST: self.silent_s})
            pages = [page for _, page in self.run(STEP_S, reports=said)]
            for page in pages:
                if isinstance(page, messages.Lost):
                    found.append(page)
                    self.answer(page)
        return found

    def answer(self, page):
        kind = page.kind if page.kind == lost.REVOKED else self.kind
        for cell in self.answering:
            self.program.on_answer(cell, page._replace(kind=kind))


def steps(pages):
    """By how much the number of each page is above that of the page before."""
    return {after.number - before.number for before, after in pairwise(pages)}


def test_each_round_follows_the_last_once_all_around_have_agreed():
    table = Lossy()
    pages = table.rounds(1.0)
    assert {page[:4] for page in pages} == {(lost.DECLARED, COLUMN, ROW, 1)}
    assert steps(pages) == {1}
    assert table.notices == ["box is to cross cell 9, which is lost"]


@pytest.mark.parametrize("answering", [(), AROUND[:-1], (*AROUND[:-1], 1)])
def test_no_number_follows_the_last_one_unless_all_around_have_agreed(answering):
    pages = Lossy(answering).rounds(1.0)
    assert pages
    assert steps(pages) == {0, 2}


def test_refusal_and_late_answers_are_no_agreement():
    table = Lossy()
    table.kind = lost.REFUSED
    assert 1 not in steps(table.rounds(1.0))
    late = Lossy(())
    pages = late.rounds(0.1)
    late.answering = AROUND
    late.answer(pages[0])
    late.answering = ()
    assert 1 not in steps(late.rounds(0.5))


def test_answers_after_the_time_of_a_round_begin_it_anew():
    table = Lossy(())
    (first,) = table.rounds(STEP_S)
    # The host is held up for longer than a round lasts.
    table.now_s += 0.2
    table.answering = AROUND
    table.answer(first)
    assert table.rounds(STEP_S)[0].number == first.number + 2


def test_cell_that_is_heard_is_not_declared_lost():
    table = Lossy()
    table.silent_s = LOST_S - 0.1
    assert not table.rounds(1.0)
    table.silent_s = LOST_S
    assert table.rounds(0.1)
    table.silent_s = 0.0
    assert not table.rounds(0.5)


def test_nothing_is_declared_where_no_parcel_wants_the_square_or_parcels_go_on_without_a_host():
    assert not Lossy().rounds(1.0, wants=0)
    assert not Lossy(go_on=True).rounds(1.0)


def test_cells_that_are_lost_side_by_side_are_not_crossed_and_said_so():
    table = Lossy()
    table.program.on_lost_cells(frozenset((LOST, 10)))
    assert not table.rounds(2.0)
    assert "cells 9, 10 are lost side by side: no parcel crosses them" in table.notices


def test_returned_cell_is_revoked_until_all_around_have_heard_it():
    table = Lossy()
    number = table.rounds(0.5)[-1].number
    table.program.on_lost_cells(frozenset())
    table.answering = ()
    pages = table.rounds(0.5)
    assert set(pages) == {(lost.REVOKED, COLUMN, ROW, 1, number + 1)}
    table.answering = AROUND
    table.rounds(0.1)
    assert not table.rounds(0.5)
