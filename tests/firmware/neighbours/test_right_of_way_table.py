"""Parcels on a larger table, driven by random choices, never come to the same cell."""

from dataclasses import replace

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from tests.prove.cells import Delivery
from tests.prove.parcels import Grid, Situation

from mdms_cell.rights.right_of_way import BOUND, CLEAR, PROMISED, PROMISED_TO, UNDER, RightOfWay

GRID = Grid(5, 4)
CELLS = range(20)
PARCELS = 3
LEASE_BEATS, LATE_BEATS, HOLD_BEATS = 6, 2, 2
BOUND_BEATS = LEASE_BEATS + LATE_BEATS + HOLD_BEATS


class Table(RuleBasedStateMachine):
    """Twenty cells and three parcels; frames are lost or late, cells restart at any time."""

    @initialize()
    def start(self):
        self.cells = [
            RightOfWay(
                lease_beats=LEASE_BEATS, late_beats=LATE_BEATS, hold_beats=HOLD_BEATS, hops=1
            )
            for _ in CELLS
        ]
        self.parcels = [Situation(frozenset({cell}), frozenset({cell})) for cell in (6, 8, 12)]
        self.in_flight = {}
        self.wants = [0] * len(self.cells)
        for _ in range(BOUND_BEATS + 3):
            self.update({})

    @rule(
        choices=st.lists(st.integers(0, 5), min_size=PARCELS, max_size=PARCELS),
        disturbed=st.dictionaries(st.sampled_from(CELLS), st.integers(0, 255), max_size=6),
        lost=st.booleans(),
        beats=st.integers(1, 5),
    )
    def go_on(self, choices, disturbed, lost, beats):
        """Parcels choose; for some beats what these cells send by some links is late or lost."""
        for number, choice in enumerate(choices):
            parcel = self.parcels[number]
            after = GRID.next_of(parcel, self.may_drive(number + 1))
            self.parcels[number] = after[min(choice, len(after) - 1)]
        for _ in range(beats):
            self.update(disturbed, lost)

    @rule(cell=st.sampled_from(CELLS))
    def restart(self, cell):
        self.cells[cell].restart()
        self.wants[cell] = 0

    def update(self, disturbed, lost=True):
        """A beat: every cell sends, then every cell decides."""
        late, self.in_flight = self.in_flight, {}
        sent = [
            (cell.identity, cell.state, self.wants[number], cell.hold)
            for number, cell in enumerate(self.cells)
        ]
        for (there, direction), estimate in late.items():
            self.hand_over(there, direction, estimate)
        for number, (identity, state, wants, hold) in enumerate(sent):
            for direction, there in GRID.neighbours[number].items():
                if not identity:
                    continue
                estimate = identity, state, wants >> direction & 1, hold
                if not disturbed.get(number, 0) >> direction & 1:
                    self.hand_over(there, direction, estimate)
                elif not lost:
                    self.in_flight[there, direction] = estimate
        for number, cell in enumerate(self.cells):
            over, wants = self.stands_on(number)
            cell.on_beat(over, wants, bool(over))
            self.wants[number] = wants if cell.state == UNDER else 0

    def hand_over(self, there, direction, estimate):
        delivery = Delivery()
        delivery.put(direction ^ 4, estimate)
        delivery.hand_over(self.cells[there])

    def stands_on(self, cell):
        for identity, parcel in enumerate(self.parcels, 1):
            if cell in parcel.covers:
                links = GRID.neighbours[cell].items()
                return identity, sum(1 << d for d, there in links if there in parcel.needs)
        return 0, 0

    def may_drive(self, identity):
        return any(
            self.cells[cell].drive_beats and self.cells[cell].identity == identity
            for cell in self.parcels[identity - 1].covers
        )

    @invariant()
    def no_two_parcels_touch(self):
        covered = [cell for parcel in self.parcels for cell in parcel.covers]
        assert len(covered) == len(set(covered))

    @invariant()
    def no_cell_is_promised_while_another_parcel_stands_there(self):
        for number, cell in enumerate(self.cells):
            over, _ = self.stands_on(number)
            assert not over or cell.state < PROMISED or cell.identity == over

    @invariant()
    def wheels_turn_only_where_all_that_is_needed_is_promised(self):
        for number, cell in enumerate(self.cells):
            for direction, there in GRID.neighbours[number].items():
                if cell.drive_beats and self.wants[number] >> direction & 1:
                    other = self.cells[there].registers
                    assert other[PROMISED_TO] in (0, cell.identity)
                    assert other[BOUND] >= cell.drive_beats

    def teardown(self):
        """Once all arrives and nobody wishes to go, every parcel may drive where it stands."""
        if not hasattr(self, "cells"):
            return
        self.parcels = [
            replace(each, goal=each.place) if not each.on_its_way else each for each in self.parcels
        ]
        for _ in range(3 * BOUND_BEATS):
            self.update({})
        for identity in range(1, PARCELS + 1):
            assert self.may_drive(identity)
        assert all(cell.hold == CLEAR for cell in self.cells)


Table.TestCase.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)
TestTable = Table.TestCase
