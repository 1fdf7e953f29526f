"""Events are listed in the order of their times, with the remedies of each."""

import pytest

from mdms_host.page.events import KEPT, EventList, event_of, events_of, in_page_units
from mdms_model.run.record import Event


def test_events_of_several_sources_are_in_the_order_of_their_times():
    events = EventList()
    events.add([event_of(2.0, "coordinator", "running")])
    events.add([event_of(1.5, "fault", "off begins"), event_of(2.0, "page", "stop all")])
    (message,) = events.take_message()
    assert [event["text"] for event in message["events"]] == ["off begins", "running", "stop all"]
    assert events.take_message() == []
    assert events.message_of_all()["events"] == message["events"]


def test_a_late_client_gets_the_last_of_them():
    events = EventList()
    events.add([event_of(number / 10, "page", f"{number}") for number in range(KEPT + 5)])
    assert len(events.take_message()[0]["events"]) == KEPT + 5
    kept = events.message_of_all()["events"]
    assert (len(kept), kept[-1]["text"]) == (KEPT, f"{KEPT + 4}")


def test_an_event_with_a_remedy_has_it_and_is_a_trouble():
    tip = Event(1.0, "tip", "the supports no longer hold its centre of mass", parcel="box")
    (shown,) = events_of([tip])
    assert shown["text"] == "box: the supports no longer hold its centre of mass"
    assert "Lift the parcel" in shown["advice"]
    assert shown["trouble"]
    (shown,) = events_of([Event(1.0, "fault", "off begins", cell=3)])
    assert (shown["cell"], "trouble" in shown, "advice" in shown) == (3, False, False)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (
            "set down at x 0.1234 m, y -0.0001 m, yaw 0.5236 rad",
            "set down at x 123.4 mm, y -0.1 mm, yaw 30.00°",
        ),
        ("at x = -0.0000 m", "at x = 0.0 mm"),
        ("moves at 0.25 m/s, 2 m away", "moves at 250 mm/s, 2000 mm away"),
        ("cell 5 m3 has 10 mm, 3 ms and 2 m² left", "cell 5 m3 has 10 mm, 3 ms and 2 m² left"),
    ],
)
def test_lengths_and_angles_are_in_the_units_of_the_page(text, shown):
    assert in_page_units(text) == shown
    assert event_of(1.0, "page", text)["text"] == shown
