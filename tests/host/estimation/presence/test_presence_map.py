import numpy as np
import pytest

from mdms_host.estimation.presence import PresenceMap

CELLS, SENSORS = 6, 5
#: Cells 1 to 4 lie deep under a parcel, the others far beside it.
UNDER_M = np.repeat([-0.05] * 4 + [0.05] * 2, SENSORS)
NOTHING = np.zeros(CELLS * SENSORS, dtype=bool)


def reporting(bits: list[int], now_s: float = 0.0, **keys: float) -> PresenceMap:
    presence = PresenceMap(CELLS, SENSORS, 0.2, (0.004,) * CELLS)
    repeat(presence, bits, now_s)
    return presence


def repeat(presence: PresenceMap, bits: list[int], now_s: float) -> list[tuple[float, int]]:
    edges: list[tuple[float, int]] = []
    for cell, each in enumerate(bits, 1):
        edges += presence.on_report(now_s, cell, each)
    return edges


def judged(presence: PresenceMap, bits: list[int], seconds: float) -> list[tuple[int, list[int]]]:
    """Sensors that lose belief in this time of judging, from 1 s on, while cells repeat."""
    fallen = []
    for step in range(round(seconds * 100)):
        now_s = 1.0 + step / 100
        if step % 20 == 0:
            repeat(presence, bits, now_s)
        fallen += presence.judge(now_s, UNDER_M, NOTHING, NOTHING)
    return fallen


RIGHT = [0b11111] * 4 + [0] * 2
#: The first sensor of the first cell shows nothing.
WRONG = [0b11110, *RIGHT[1:]]


def test_a_change_has_happened_before_it_was_reported_by_the_debounce() -> None:
    presence = reporting(RIGHT)
    assert repeat(presence, [0b11011, *RIGHT[1:]], 0.1) == [(pytest.approx(0.096), 2)]


def test_a_change_after_a_report_that_got_lost_has_no_time() -> None:
    """It may be the lost one, which its cell has repeated."""
    presence = reporting(RIGHT)
    assert repeat(presence, [0b11011, *RIGHT[1:]], 0.3) == []
    assert presence.covered[:5].tolist() == [True, True, False, True, True]


def test_after_deafness_each_cell_counts_from_its_next_report_on() -> None:
    presence = reporting(RIGHT)
    assert not presence.may_be_old(0.15).any()
    presence.on_deafness(0.15)
    assert presence.may_be_old(0.15).all()
    assert list(presence.on_report(0.16, 1, 0b11011)) == []
    assert presence.may_be_old(0.17).tolist() == [False] * SENSORS + [True] * 5 * SENSORS
    assert list(presence.on_report(0.17, 1, 0b11111)) == [(pytest.approx(0.166), 2)]


def test_a_change_may_be_as_old_as_the_report_before_it_only_while_frames_get_lost() -> None:
    presence = reporting(RIGHT)
    list(presence.on_report(0.1, 1, 0b11110))
    assert presence.since_s[0] == 0.1
    presence.on_loss(0.12)
    list(presence.on_report(0.15, 1, 0b11111))
    assert presence.since_s[0] == 0.1


def test_cells_that_are_ignored_are_not_waited_for_and_show_nothing() -> None:
    presence = PresenceMap(2, 5, 0.2, (0.004,) * 2)
    list(presence.on_report(0.0, 2, 0b11111))
    assert not presence.complete
    presence.ignore({1})
    assert presence.complete
    assert presence.valid(0.1).nonzero()[0].tolist() == [5, 6, 7, 8, 9]
    presence.ignore(())
    assert not presence.complete


def test_a_report_that_is_not_repeated_is_not_valid_any_more() -> None:
    presence = reporting(RIGHT)
    assert presence.valid(0.5).all()
    assert not presence.valid(0.7).any()
    list(presence.on_report(0.7, 2, 0b11111))
    assert presence.valid(0.8).nonzero()[0].tolist() == [5, 6, 7, 8, 9]


def test_what_a_cell_has_not_repeated_in_time_may_be_old_and_all_after_a_frame_has_got_lost() -> (
    None
):
    presence = reporting(RIGHT)
    assert not presence.may_be_old(0.21).any()
    list(presence.on_report(0.2, 2, 0b11111))
    assert (~presence.may_be_old(0.23)).nonzero()[0].tolist() == [5, 6, 7, 8, 9]
    presence.on_loss(0.24)
    assert presence.may_be_old(0.25).all()
    repeat(presence, RIGHT, 1.2)
    assert not presence.may_be_old(1.3).any()


def test_a_sensor_that_contradicts_all_others_is_not_believed_after_a_while() -> None:
    presence = reporting(WRONG)
    assert judged(presence, WRONG, 0.25) == []
    assert judged(presence, WRONG, 0.4) == [(1, [0])]
    assert repeat(presence, RIGHT, 1.4) == []


def test_a_report_that_is_not_repeated_is_not_judged() -> None:
    """A parcel may have come over it since."""
    presence = reporting(WRONG, 0.5)
    for step in range(200):
        now_s = 2.0 + step / 100
        for cell in range(2, CELLS + 1):
            list(presence.on_report(now_s, cell, RIGHT[cell - 1]))
        assert presence.judge(now_s, UNDER_M, NOTHING, NOTHING) == []


def test_a_while_in_which_nothing_was_judged_makes_no_sensor_wrong() -> None:
    presence = reporting(RIGHT, 1.0)
    assert presence.judge(1.0, UNDER_M, NOTHING, NOTHING) == []
    repeat(presence, WRONG, 4.0)
    assert presence.judge(4.0, UNDER_M, NOTHING, NOTHING) == []
    assert presence.valid(4.0).all()


def test_sensors_that_turn_wrong_ever_again_are_noisy_and_one_that_is_stuck_is_not() -> None:
    presence = reporting(RIGHT)
    presence.judge(1.0, UNDER_M, NOTHING, NOTHING)
    for step in range(1, 100):
        repeat(presence, WRONG, 1.0 + step / 100)
        presence.judge(1.0 + step / 100, UNDER_M, NOTHING, NOTHING)
    assert not presence.noisy
    for step in range(100, 200):
        wrong = RIGHT.copy()
        wrong[step // 10 % 6] ^= (step // 5 % 2) << step // 7 % 5
        repeat(presence, wrong, 1.0 + step / 100)
        presence.judge(1.0 + step / 100, UNDER_M, NOTHING, NOTHING)
    assert presence.noisy
    for step in range(200, 800):
        repeat(presence, RIGHT, 1.0 + step / 100)
        presence.judge(1.0 + step / 100, UNDER_M, NOTHING, NOTHING)
    assert not presence.noisy


def test_nothing_is_judged_by_a_belief_that_a_third_of_the_sensors_contradict() -> None:
    bits = [0, *RIGHT[1:]]
    assert judged(reporting(bits), bits, 2.0) == []


def test_a_sensor_that_is_right_again_is_believed_again_much_later() -> None:
    presence = reporting(WRONG)
    judged(presence, WRONG, 0.4)
    judged(presence, RIGHT, 0.5)
    assert not presence.valid(2.0)[0]
    judged(presence, RIGHT, 5.0)
    assert presence.valid(2.0)[0]


def test_a_cell_most_of_whose_sensors_are_wrong_is_not_believed_at_all() -> None:
    """It may be in another's place, where the others are right by chance."""
    presence = reporting(RIGHT)
    assert judged(presence, [0b11100, *RIGHT[1:]], 0.5) == [(1, [0, 1])]
    presence = reporting(RIGHT)
    assert judged(presence, [0b11000, *RIGHT[1:]], 0.5) == [(1, [0, 1, 2, 3, 4])]
