"""Signals that end the command: SIGTERM and SIGHUP as Ctrl-C does, but for the exit code."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn
from weakref import WeakSet

#: The signals that end a service in order, as far as the system has them.
ENDS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
#: An exception that a signal raised and that was lost is raised again after so long [s].
AGAIN_S = 0.5


class Interrupted(KeyboardInterrupt):
    """Ctrl-C."""


class Terminated(KeyboardInterrupt):
    """Somebody ends the command by SIGTERM, or the terminal is gone (SIGHUP)."""


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Raises `Terminated` or `Interrupted` where the main thread stands, meanwhile.

    A signal that is ignored, as SIGHUP is under nohup, stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _numbers("SIGTERM", "SIGHUP")}
    ends: dict[int, type[KeyboardInterrupt]] = {
        number: Terminated for number, handler in before.items() if handler != signal.SIG_IGN
    }
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        ends[signal.SIGINT] = Interrupted
    taken = {number: signal.signal(number, _ending(error)) for number, error in ends.items()}
    alarm = {number: signal.getsignal(number) for number in _numbers("SIGALRM")}
    try:
        yield
    finally:
        if alarm:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in {**taken, **alarm}.items():
            signal.signal(number, handler)


@contextmanager
def interrupted() -> Iterator[Callable[[], KeyboardInterrupt | None]]:
    """What asks for the end by a signal, None while nothing does: no step is broken off meanwhile.

    A second signal breaks it off. Where SIGHUP is ignored, as under nohup, it stays ignored.
    """
    asked: list[KeyboardInterrupt] = []

    def on_signal(number: int, _frame: FrameType | None) -> None:
        end = Interrupted() if number == signal.SIGINT else Terminated()
        if asked:
            raise end
        asked.append(end)

    def first() -> KeyboardInterrupt | None:
        return asked[0] if asked else None

    if threading.current_thread() is not threading.main_thread():
        yield first
        return
    kept = [number for number in _numbers("SIGHUP") if signal.getsignal(number) == signal.SIG_IGN]
    numbers = (number for number in ENDS if number not in kept)
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield first
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def ending_behind(error: BaseException | None) -> KeyboardInterrupt | None:
    """What ended the command, if that led to this error: a compiler may wrap it in its own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


def _numbers(*names: str) -> list[int]:
    """Those of the signals that the system has."""
    return [getattr(signal, name) for name in names if hasattr(signal, name)]


def _ending(error: type[KeyboardInterrupt]) -> Callable[[int, FrameType | None], None]:
    """A handler that raises the error until it has arrived.

    Compiled code that calls back into Python may drop an exception that is raised there. One that
    is on its way, or kept by whoever caught it, still exists; one that was dropped does not.
    """
    raised: WeakSet[KeyboardInterrupt] = WeakSet()

    def end(_number: int, _frame: FrameType | None) -> NoReturn:
        _repeat(again)
        raise _kept(error(), raised)

    def again(_number: int, _frame: FrameType | None) -> None:
        if not raised:
            end(_number, _frame)

    return end


def _repeat(handler: Callable[[int, FrameType | None], None]) -> None:
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S, AGAIN_S)


def _kept(error: KeyboardInterrupt, raised: WeakSet[KeyboardInterrupt]) -> KeyboardInterrupt:
    """The error, noted; no variable of the frame that raises it keeps it alive."""
    raised.add(error)
    return error
