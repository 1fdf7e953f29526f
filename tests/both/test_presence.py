"""Presence bits without their flicker."""

from mdms_cell import ticks
from mdms_cell.perception.sensors import Presence


def debounced(debounce_ms=4, start_ms=0):
    presence = Presence()
    presence.debounce_ms = debounce_ms
    presence.step(0, start_ms)
    return presence


def test_change_counts_after_its_debounce_and_no_sooner():
    presence = debounced()
    assert presence.step(0b1, 10) == 4
    assert presence.step(0b1, 13) == 1
    assert presence.bits == 0
    assert presence.step(0b1, 14) == ticks.IDLE_MS
    assert presence.bits == 0b1


def test_one_reading_the_old_way_begins_the_change_anew():
    presence = debounced()
    presence.step(0b1, 10)
    assert presence.step(0, 12) == ticks.IDLE_MS
    presence.step(0b1, 13)
    presence.step(0b1, 16)
    assert presence.bits == 0
    presence.step(0b1, 17)
    assert presence.bits == 0b1


def test_sensors_change_apart_from_each_other():
    presence = debounced()
    presence.step(0b00001, 10)
    assert presence.step(0b10001, 12) == 2
    assert presence.step(0b10001, 14) == 2
    assert presence.bits == 0b00001
    presence.step(0b10001, 16)
    assert presence.bits == 0b10001
    assert presence.read() == presence.bits


def test_each_of_eight_sensors_has_its_bit():
    for sensor in range(8):
        presence = debounced()
        presence.step(1 << sensor, 10)
        presence.step(1 << sensor, 14)
        assert presence.bits == 1 << sensor


def test_change_counts_at_once_without_debounce():
    presence = debounced(0)
    assert presence.step(0b101, 10) == ticks.IDLE_MS
    assert presence.bits == 0b101


def test_change_counts_in_time_where_the_clock_wraps():
    presence = debounced(4, (1 << 30) - 2)
    presence.step(0b1, (1 << 30) - 1)
    presence.step(0b1, 2)
    assert presence.bits == 0
    presence.step(0b1, 3)
    assert presence.bits == 0b1
