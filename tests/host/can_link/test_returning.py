"""A link whose device is gone drops frames, opens it again, and says both once."""

import time
from collections.abc import Callable
from threading import Event, Thread

import pytest

from mdms_host.can_link.delays import Delays
from mdms_host.can_link.link import DeviceGoneError, LinkCounts, NoBusError
from mdms_host.can_link.returning import ReturningLink
from mdms_host.clock import MonotonicClock
from mdms_protocol.codecs.frame import Frame

FRAME = Frame(0x80, b"")


class Device:
    """A link that may be unplugged; `rest` says whether other buses are left."""

    def __init__(self, *, rest: bool = False) -> None:
        self.sent: list[Frame] = []
        self.gone = self.closed = False
        self.rest = rest
        self.delays = Delays()
        self.incidents: list[tuple[float, str]] = []

    @property
    def counts(self) -> LinkCounts:
        return LinkCounts(0, 0, 0, len(self.sent))

    def send(self, frame: Frame) -> None:
        if self.gone:
            raise DeviceGoneError("unplugged")
        self.sent.append(frame)

    def send_polled(self, participant, now_s: float) -> None:
        for frame in participant.poll(now_s):
            self.send(frame)

    def receive(self, timeout_s: float, handle) -> None:
        if self.gone:
            raise DeviceGoneError("unplugged")

    def leave_gone(self) -> bool:
        self.gone = self.gone and not self.rest
        return self.rest

    def close(self) -> None:
        self.closed = True


class Asks:
    """A participant that counts how often it was polled."""

    polls = 0

    def poll(self, _now_s: float) -> list[Frame]:
        self.polls += 1
        return [FRAME]


def until(link: ReturningLink, done: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < end_s
        link.receive(0.01, None)


@pytest.fixture(autouse=True)
def _soon(monkeypatch) -> None:
    monkeypatch.setattr("mdms_host.can_link.returning.AGAIN_S", 0.01)


def test_it_is_opened_again_once_it_is_there_and_the_run_has_ended() -> None:
    first, second = Device(), Device()
    opened: list = [first, NoBusError("not yet"), NoBusError("not yet"), second]

    def open_link(_noted):
        device = opened.pop(0)
        if isinstance(device, Exception):
            raise device
        return device

    gone: list[str] = []
    rests = False
    with ReturningLink(open_link, MonotonicClock()) as link:
        link.on_gone, link.at_rest = gone.append, lambda: rests
        link.send(FRAME)
        first.gone = True
        asks = Asks()
        for _ in range(3):
            link.send_polled(asks, 0.0)
        assert gone == ["unplugged"]
        assert not link.is_there
        assert asks.polls == 3
        until(link, lambda: not opened)
        for _ in range(10):
            link.receive(0.0, None)
        assert not link.is_there
        rests = True
        until(link, lambda: link.is_there)
        link.send(FRAME)
        assert link.counts.unsent == 2
    assert first.closed
    assert second.closed
    assert second.sent == [FRAME]
    texts = [text for _, text in link.incidents]
    assert texts == [
        "unplugged; it is opened again",
        "the CAN device is there again; nothing moves before it is started",
    ]


def test_other_buses_bring_their_cells_to_rest_before_all_are_opened_again() -> None:
    first, second = Device(rest=True), Device()
    opened = [first, second]
    rests = False
    with ReturningLink(lambda _noted: opened.pop(0), MonotonicClock()) as link:
        link.at_rest = lambda: rests
        first.gone = True
        link.send(FRAME)
        link.send(FRAME)
        assert first.sent == [FRAME]
        assert not first.closed
        rests = True
        until(link, lambda: link.is_there)
        assert first.closed


def test_a_device_that_is_not_there_at_the_beginning_is_an_error() -> None:
    def none(_noted):
        raise NoBusError("no such device")

    with pytest.raises(NoBusError):
        ReturningLink(none, MonotonicClock())


def test_a_device_that_hangs_as_it_is_opened_keeps_nobody_from_the_end(
    monkeypatch, request
) -> None:
    monkeypatch.setattr("mdms_host.can_link.returning.HANGS_S", 0.05)
    opens, over, first = Event(), Event(), Device()
    request.addfinalizer(over.set)

    def open_link(_noted) -> Device:
        if first.gone:
            opens.set()
            over.wait()
            raise NoBusError("too late")
        return first

    link = ReturningLink(open_link, MonotonicClock())
    first.gone = True
    until(link, opens.is_set)
    closing = Thread(target=link.close, daemon=True)
    closing.start()
    closing.join(5.0)
    assert not closing.is_alive()
