import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_sim.kernel import Kernel

events = st.lists(st.tuples(st.integers(0, 50), st.integers(0, 3)), max_size=60)


@given(events)
def test_events_run_by_time_then_priority_then_order_of_request(asked):
    kernel = Kernel()
    ran = []
    for number, (time_ns, priority) in enumerate(asked):
        kernel.at(time_ns, priority, lambda n=number: ran.append((kernel.now_ns, n)))
    kernel.run_until(50)
    by_rule = sorted(range(len(asked)), key=lambda n: (*asked[n], n))
    assert ran == [(asked[n][0], n) for n in by_rule]


def test_an_event_may_ask_for_another_at_the_same_instant():
    kernel = Kernel()
    ran = []
    kernel.at(5, 1, lambda: ran.append("later"))
    kernel.at(5, 0, lambda: kernel.at(5, 0, lambda: ran.append("inserted")))
    kernel.run_until(5)
    assert ran == ["inserted", "later"]


def test_the_clock_stands_at_the_end_and_later_events_wait():
    kernel = Kernel()
    ran = []
    kernel.at(11, 0, lambda: ran.append(kernel.now_ns))
    kernel.run_until(10)
    assert (kernel.now_ns, kernel.next_ns, ran) == (10, 11, [])
    kernel.run_until(11)
    assert (kernel.next_ns, ran) == (None, [11])


def test_the_past_is_refused():
    kernel = Kernel()
    kernel.run_until(10)
    with pytest.raises(ValueError, match="asked for 9 ns, but it is 10 ns already"):
        kernel.at(9, 0, print)
