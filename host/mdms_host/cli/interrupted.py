"""Signals that end what goes on in real time, between two steps and not within one."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event

#: The signals that end a service in order.
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def interrupted() -> Iterator[Callable[[], bool]]:
    """Whether the end was asked for by a signal: no step of the simulation is broken off.

    A second signal breaks it off.
    """
    pressed = Event()

    def on_signal(*_: object) -> None:
        if pressed.is_set():
            raise KeyboardInterrupt
        pressed.set()

    before = {number: signal.signal(number, on_signal) for number in ENDS}
    try:
        yield pressed.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
