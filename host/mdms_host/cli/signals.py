"""Signals that end the command: Ctrl-C, and two that do as it does, but for their exit code.

Numba looks up attributes of records, and makes machine code, by way of C that drops whatever is
raised there. A signal that meets such a place comes again once the main thread has left it.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

#: Modules that are called by C which drops exceptions.
_DROPPING = ("numpy.core.records.", "numpy._core.records.", "llvmlite.")
#: Such a place is left within microseconds as a rule [s].
_AGAIN_S = 0.002


class Terminated(KeyboardInterrupt):
    """Somebody ends the command by SIGTERM, or the terminal is gone (SIGHUP)."""


@contextmanager
def terminating() -> Iterator[None]:
    """Raises `Terminated` where the main thread stands, meanwhile, on SIGTERM and SIGHUP.

    On SIGINT it is KeyboardInterrupt, as ever. One that is ignored, as SIGHUP is under nohup, stays
    ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    errors = {"SIGTERM": Terminated, "SIGHUP": Terminated, "SIGINT": KeyboardInterrupt}
    raised = {getattr(signal, name): errors[name] for name in errors if hasattr(signal, name)}
    before = {number: signal.getsignal(number) for number in raised}
    taken = {number: handler for number, handler in before.items() if handler != signal.SIG_IGN}
    for number in taken:
        signal.signal(number, _raising(raised[number]))
    try:
        yield
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)


def _raising(error: type[BaseException]) -> Callable[[int, FrameType | None], None]:
    def handle(number: int, frame: FrameType | None) -> None:
        if not _is_dropped(frame):
            raise error
        again = threading.Timer(_AGAIN_S, signal.raise_signal, (number,))
        again.daemon = True
        again.start()

    return handle


def _is_dropped(frame: FrameType | None) -> bool:
    """Whether an exception at this place would get no further than to the C code that called it."""
    while frame is not None:
        if f"{frame.f_globals.get('__name__')}.".startswith(_DROPPING):
            return True
        frame = frame.f_back
    return False
