"""Signals that end the command as Ctrl-C does, but for its exit code."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn


class Terminated(KeyboardInterrupt):
    """Somebody ends the command by SIGTERM, or the terminal is gone (SIGHUP)."""


@contextmanager
def terminating() -> Iterator[None]:
    """Raises `Terminated` where the main thread stands, meanwhile, on either signal.

    One that is ignored, as SIGHUP is under nohup, stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    names = ("SIGTERM", "SIGHUP")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    taken = {number: handler for number, handler in before.items() if handler != signal.SIG_IGN}
    for number in taken:
        signal.signal(number, _terminate)
    try:
        yield
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)


def _terminate(_number: int, _frame: FrameType | None) -> NoReturn:
    raise Terminated
