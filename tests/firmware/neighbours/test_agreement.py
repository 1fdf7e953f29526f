"""Whose pose of a parcel agrees with a cell's own, and whose wheels it judges."""

from struct import pack_into

import pytest
from tests.firmware.neighbours.some_place import SENSORS_UM, SHIFTS_UM, WHEELS_UM, SomePlace

from mdms_cell.mailboxes import LENGTH
from mdms_cell.perception.angle import turn_um
from mdms_cell.perception.footprint import Footprint
from mdms_cell.perception.heard import SPEEDS_AT, Heard
from mdms_cell.perception.outline import RECTANGLE
from mdms_cell.perception.place import DIRECTIONS, OWN
from mdms_cell.perception.suspicion import CELLS, PRESENCE, WHEELS, Suspicion
from mdms_cell.perception.tracking import Agreement, Tracking
from mdms_cell.perception.twist import WHEELS as WHEELS_SHOWN
from mdms_protocol.neighbours import frames as wire

#: A parcel in the cell's frame, turned by 50 degrees [um; steps of the wire].
X_UM, Y_UM, YAW = 20_000, -10_000, wire.TURN * 50 // 360


def reported(heard: Heard, direction: int, yaw: int) -> None:
    """A neighbour has sent that pose, from its own centre, with this turn."""
    at = wire.ESTIMATE_FIELDS * direction
    for field, value in (
        (wire.X, (X_UM - SHIFTS_UM[direction][0]) // wire.STEP_UM),
        (wire.Y, (Y_UM - SHIFTS_UM[direction][1]) // wire.STEP_UM),
        (wire.YAW, yaw),
    ):
        heard.estimates[at + field] = value


@pytest.mark.parametrize("yaw", [YAW, -YAW, 0])
def test_a_neighbour_agrees_that_has_the_parcel_turned_as_this_cell_has_it(yaw) -> None:
    heard = Heard()
    for direction, its in ((0, yaw), (2, yaw), (5, yaw + wire.TURN // 8)):
        reported(heard, direction, its)
    agreement = Agreement(SomePlace(shifts_um=SHIFTS_UM), heard, Suspicion())
    peers = 1 << 0 | 1 << 2 | 1 << 5
    assert not agreement.compare(peers, (X_UM, Y_UM, turn_um(yaw)))
    assert agreement.near == 1 << 0 | 1 << 2


@pytest.fixture
def tracking() -> Tracking:
    """A cell in the middle of a parcel at rest, whose eastern wheels turn."""
    place = SomePlace(WHEELS_UM + SENSORS_UM, shifts_um=SHIFTS_UM)
    tracking = Tracking(place, Footprint(place), Heard(), Suspicion())
    tracking.belief.set(RECTANGLE, 500_000, 400_000)
    tracking.belief.start(0, 0, 0)
    tracking.belief.twist.shown[WHEELS_SHOWN] = 18
    tracking.under, tracking.sent = True, 9
    heard = tracking._heard
    heard.beat = 100
    for cell in range(DIRECTIONS + 1):
        heard.boxes.stamps[DIRECTIONS + cell] = heard.beat
    pack_into("<ii", heard.boxes.frames, LENGTH * SPEEDS_AT, 50_000, 50_000)
    return tracking


def evidence(tracking: Tracking) -> int:
    """What counts against the eastern wheels after every cell has had its turn."""
    tracking._suspicion.turn = OWN
    for _ in range(CELLS):
        tracking.judge(0)
    return tracking._suspicion.evidence[CELLS * WHEELS]


def test_wheels_that_turn_under_a_parcel_at_rest_count_against_their_cell(tracking) -> None:
    assert evidence(tracking) == 1


@pytest.mark.parametrize(("parcel_um_s", "most_um_s"), [(0, 12_000), (40_000, 62_000)])
def test_wheels_count_that_are_off_by_more_than_12_mm_s_and_a_quarter(
    tracking, parcel_um_s, most_um_s
) -> None:
    tracking.belief.twist.speeds[0] = parcel_um_s
    for speed_um_s, counts in ((most_um_s, 0), (most_um_s + 1, 1)):
        at = LENGTH * SPEEDS_AT
        pack_into("<ii", tracking._heard.boxes.frames, at, speed_um_s, 0)
        assert evidence(tracking) == counts


def test_wheels_under_another_parcel_count_against_nobody(tracking) -> None:
    tracking.others = 1 << 0
    assert evidence(tracking) == 0


def test_wheels_whose_speeds_are_of_a_beat_before_count_against_nobody(tracking) -> None:
    tracking._heard.boxes.stamps[DIRECTIONS] -= 1
    assert evidence(tracking) == 0


def test_sensors_that_contradict_count_against_the_belief_from_the_third_cell_on() -> None:
    suspicion = Suspicion()
    for cell, is_crowd in ((0, False), (3, False), (5, True)):
        suspicion.evidence[CELLS * PRESENCE + cell] = 1
        assert suspicion.crowd() == is_crowd
        assert suspicion.trusts(0) == is_crowd
