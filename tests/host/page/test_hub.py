"""The messages that wait for a client are bounded, even for a slow client."""

import asyncio

import pytest

from mdms_host.page.hub import MOST_UNSEEN, MOST_WAITING, Hub, LeaveError, PageClient


@pytest.fixture
def drained():
    """Returns all that would be sent to a client now."""
    with asyncio.Runner() as runner:
        yield lambda client: runner.run(taken_from(client))


async def taken_from(client: PageClient) -> list[str | bytes]:
    taken = []
    while True:
        try:
            taken.append(await asyncio.wait_for(client.next(), 0.01))
        except TimeoutError:
            return taken


def test_messages_come_in_order_and_before_snapshots(drained):
    client = PageClient("one")
    client.show(b"snapshot")
    client.send({"a": 1})
    client.send({"b": 2})
    assert drained(client) == ['{"a": 1}', '{"b": 2}', b"snapshot"]


def test_of_snapshots_only_the_newest_waits(drained):
    client = PageClient("one")
    for number in range(100):
        client.show(bytes([number]))
    assert drained(client) == [bytes([99])]


def test_client_that_confirms_nothing_gets_no_more_snapshots(drained):
    client = PageClient("one")
    sent = []
    for number in range(20):
        client.show(bytes([number]))
        sent += drained(client)
    assert len(sent) == MOST_UNSEEN
    assert not client.looks
    client.seen()
    assert drained(client) == [bytes([19])]


def test_confirming_a_snapshot_that_was_never_sent_brings_no_more(drained):
    client = PageClient("one")
    for _ in range(50):
        client.seen()
    sent = []
    for number in range(20):
        client.show(bytes([number]))
        sent += drained(client)
    assert len(sent) == MOST_UNSEEN


def test_client_that_misses_messages_has_to_come_again(drained):
    client = PageClient("one")
    for number in range(MOST_WAITING):
        client.send({"number": number})
    assert len(drained(client)) == MOST_WAITING
    for number in range(MOST_WAITING + 1):
        client.send({"number": number})
    with pytest.raises(LeaveError):
        drained(client)
    # Nor does anything pile up for it meanwhile.
    client.send({"number": 0})
    assert not client._messages


def test_the_first_client_that_may_is_in_control_until_another_takes_it():
    vacated = []
    hub = Hub(lambda: vacated.append(True))
    watcher, first, second = PageClient("watcher"), PageClient("first"), PageClient("second")
    first.may_control = second.may_control = True
    for client in (watcher, first, second):
        hub.come(client)
    assert hub.controller is first
    assert not hub.take(watcher)
    assert hub.take(second)
    assert hub.controller is second
    hub.leave(first)
    assert not vacated
    hub.leave(second)
    assert vacated
    assert hub.controller is None


def test_a_client_that_has_gone_takes_no_control():
    hub = Hub(lambda: None)
    gone, other = PageClient("gone"), PageClient("other")
    gone.may_control = other.may_control = True
    hub.come(gone)
    hub.leave(gone)
    assert not hub.take(gone)
    hub.come(other)
    assert hub.controller is other
