"""Promises, leases, hold and identity of one cell, as its neighbours and its wheels see them."""

import pytest
from tests.prove.cells import Delivery

from mdms_cell.rights.right_of_way import (
    BY_ANOTHER,
    CLEAR,
    NEAR,
    NONE,
    PROMISED,
    UNDER,
    RightOfWay,
)

EAST, NORTH, WEST = 0, 2, 4
TO_EAST = 1 << EAST
BOUND = 10 + 4 * (2 + 3)  # a lease, and four steps of a hold that comes late


def ready():
    """A cell whose silence after its reset is over."""
    cell = RightOfWay()
    rest(cell, BOUND + 1)
    return cell


def rest(cell, beats, **given):
    """So many beats in which nothing arrives."""
    for _ in range(beats):
        beat(cell, **given)


def beat(cell, *messages, over=0, wants=0, occupied=False):
    """A beat in which these estimates arrive."""
    delivery = Delivery()
    for direction, *message in messages:
        delivery.put(direction, message)
    delivery.hand_over(cell)
    cell.on_beat(over, wants, occupied)


def asks(identity, direction=WEST, hold=CLEAR):
    """The estimate of a neighbour under a parcel that needs this cell."""
    return direction, identity, UNDER, True, hold


def promise(identity, direction=EAST):
    """The estimate of a neighbour that is promised to a parcel."""
    return direction, identity, PROMISED, False, CLEAR


def test_cell_that_is_wanted_promises_itself_and_says_so():
    cell = ready()
    beat(cell, asks(7))
    assert (cell.identity, cell.state) == (7, PROMISED)


def test_cell_is_silent_about_promises_after_a_reset():
    cell = RightOfWay()
    for _ in range(BOUND):
        beat(cell, asks(7))
        assert cell.state < PROMISED
    beat(cell, asks(7))
    assert cell.state == PROMISED


def test_cell_does_not_promise_a_square_that_a_sensor_sees_covered():
    cell = ready()
    beat(cell, asks(7), occupied=True)
    assert cell.state == NEAR


def test_a_promise_is_broken_off_for_what_is_set_down_there():
    cell = ready()
    beat(cell, asks(7))
    beat(cell, asks(7), occupied=True)
    assert cell.state == PROMISED
    for _ in range(2):
        beat(cell, asks(7), occupied=BY_ANOTHER)
        assert cell.state == NEAR
    # The thing is gone again.
    beat(cell, asks(7))
    assert (cell.identity, cell.state) == (7, PROMISED)


def test_another_waits_after_a_promise_was_broken_off_until_all_wheels_stand():
    cell = ready()
    beat(cell, asks(7))
    beat(cell, (WEST, 7, UNDER, False, CLEAR), asks(3, NORTH), occupied=BY_ANOTHER)
    for _ in range(BOUND):
        assert cell.state < PROMISED
        beat(cell, asks(3, NORTH))
    assert (cell.identity, cell.state) == (3, PROMISED)


def test_promise_ends_when_the_wish_does_and_another_waits_until_all_wheels_stand():
    cell = ready()
    beat(cell, asks(7))
    beat(cell, (WEST, 7, UNDER, False, CLEAR), asks(3, NORTH))
    for _ in range(BOUND):
        assert cell.state < PROMISED
        beat(cell, asks(3, NORTH))
    assert (cell.identity, cell.state) == (3, PROMISED)


def test_promise_outlives_lost_estimates_for_as_long_as_the_last_may_count():
    cell = ready()
    beat(cell, asks(7))
    rest(cell, 7)
    assert cell.state == PROMISED
    rest(cell, 1)
    assert cell.state == NONE


def test_of_two_that_ask_in_one_beat_the_lower_identity_is_promised_to():
    cell = ready()
    beat(cell, asks(9), asks(4, NORTH))
    assert cell.identity == 4


def test_parcel_that_had_the_cell_goes_last():
    cell = ready()
    beat(cell, over=4)
    beat(cell)
    for _ in range(BOUND + 1):
        beat(cell, asks(4), asks(9, NORTH))
    assert (cell.identity, cell.state) == (9, PROMISED)


def test_parcel_set_down_on_a_promised_cell_does_not_drive_until_the_other_promise_is_over():
    cell = ready()
    beat(cell, asks(7))
    for _ in range(BOUND):
        beat(cell, over=9)
        assert (cell.identity, cell.state, cell.drive_beats) == (9, NEAR, 0)
    beat(cell, over=9)
    assert (cell.identity, cell.state, cell.drive_beats) == (9, UNDER, 8)


def test_wheels_turn_while_the_lease_lasts_and_no_longer():
    cell = ready()
    beat(cell, over=7, wants=TO_EAST)
    assert (cell.drive_beats, cell.hold, cell.lacking) == (0, 0, TO_EAST)
    beat(cell, promise(7), over=7, wants=TO_EAST)
    for left in range(8, 0, -1):
        assert (cell.drive_beats, cell.hold) == (left, CLEAR)
        beat(cell, over=7, wants=TO_EAST)
    assert (cell.drive_beats, cell.hold) == (0, 0)


def test_promise_to_another_parcel_is_none():
    cell = ready()
    beat(cell, over=7, wants=TO_EAST)
    beat(cell, promise(9), over=7, wants=TO_EAST)
    assert cell.drive_beats == 0


@pytest.mark.parametrize(("held", "passed_on"), [(0, 1), (1, 2), (3, 4), (4, CLEAR), (6, 1)])
def test_hold_is_passed_on_one_step_further(held, passed_on):
    cell = ready()
    beat(cell, over=7, wants=TO_EAST)
    beat(cell, (EAST, 7, UNDER, True, held), over=7, wants=TO_EAST)
    assert cell.hold == passed_on
    assert (cell.drive_beats > 0) == (passed_on == CLEAR)


def test_neighbour_that_falls_silent_under_the_parcel_stops_it_before_its_promise_ends():
    cell = ready()
    beat(cell, over=7, wants=TO_EAST)
    beat(cell, (EAST, 7, UNDER, True, CLEAR), over=7, wants=TO_EAST)
    for left in (3, 2, 1, 0):
        assert cell.drive_beats == left
        beat(cell, over=7, wants=TO_EAST)
    assert cell.hold == 1


def test_held_parcel_yields_soon_to_a_lower_identity_and_late_to_a_higher_one():
    for other, patience_beats in ((3, 25), (9, 100)):
        cell = ready()
        beat(cell, asks(7, hold=0))
        for _ in range(patience_beats - 1):
            beat(cell, asks(7, hold=0), asks(other, NORTH, hold=0))
            assert (cell.identity, cell.state) == (7, PROMISED)
        for _ in range(BOUND + 1):
            beat(cell, asks(7, hold=0), asks(other, NORTH, hold=0))
        assert (cell.identity, cell.state) == (other, PROMISED)


def test_parcel_that_may_go_keeps_its_promise_however_long_another_waits():
    cell = ready()
    beat(cell, asks(7))
    for _ in range(300):
        beat(cell, asks(7), asks(3, NORTH, hold=0))
        assert (cell.identity, cell.state) == (7, PROMISED)


def test_identity_comes_from_a_neighbour_under_the_parcel_and_goes_within_a_lease():
    cell = ready()
    beat(cell, (WEST, 7, UNDER, False, CLEAR))
    assert (cell.identity, cell.state) == (7, NEAR)
    rest(cell, 8)
    assert (cell.identity, cell.state) == (0, NONE)


def test_identity_does_not_come_from_a_neighbour_that_is_only_near_or_promised():
    cell = ready()
    beat(cell, promise(7), (WEST, 7, NEAR, False, CLEAR))
    assert cell.identity == 0


def test_identity_of_a_parcel_that_left_goes_within_a_lease():
    cell = ready()
    rest(cell, 5, over=7)
    rest(cell, 9)
    assert (cell.identity, cell.state) == (0, NONE)


def test_cell_between_two_parcels_stays_with_the_first():
    cell = ready()
    beat(cell, (WEST, 7, UNDER, False, CLEAR))
    for _ in range(20):
        beat(cell, (EAST, 3, UNDER, False, CLEAR), (WEST, 7, UNDER, False, CLEAR))
        assert cell.identity == 7


def test_gap_without_updates_stops_the_wheels_and_voids_earlier_reports():
    cell = ready()
    beat(cell, over=7, wants=TO_EAST)
    beat(cell, promise(7), over=7, wants=TO_EAST)
    cell.on_gap()
    assert cell.drive_beats == 0
    beat(cell, over=7, wants=TO_EAST)
    assert (cell.drive_beats, cell.hold) == (0, 0)


def test_cell_that_has_restarted_is_near_the_parcel_over_it_before_others_confirm_it():
    cell = RightOfWay()
    cell.restart(neighbours=1)
    beat(cell, over=7, occupied=True)
    assert (cell.identity, cell.state) == (7, NEAR)
    assert cell.unsure
