"""The clock that wraps: instants and the times between them."""

from mdms_cell import ticks

WRAP = 1 << 30
LONGEST = (1 << 29) - 1
INSTANTS = (0, 1, 500, LONGEST, LONGEST + 1, LONGEST + 2, WRAP - 500, WRAP - 1)
DELAYS = (0, 1, 100, 65_535, LONGEST)


def test_instant_after_a_delay_is_that_much_later_wherever_the_clock_wraps():
    for start_ms in INSTANTS:
        for delay_ms in DELAYS:
            end_ms = ticks.after(start_ms, delay_ms)
            assert 0 <= end_ms < WRAP
            assert ticks.diff(end_ms, start_ms) == delay_ms
            assert ticks.diff(start_ms, end_ms) == -delay_ms


def test_clock_begins_anew_after_its_last_millisecond():
    assert ticks.after(WRAP - 1, 1) == 0
    assert ticks.after(WRAP - 1, 0) == WRAP - 1
    assert ticks.diff(0, WRAP - 1) == 1


def test_half_a_turn_counts_as_earlier():
    assert ticks.diff(1 << 29, 0) == -(1 << 29)
