"""Keeps the machine and the interpreter from holding up what is due in real time."""

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from mdms_host.clock import Clock, MonotonicClock

#: How long a thread may compute while another waits for its turn [s]; Python's own is 5 ms.
_TURN_S = 0.001
#: The lowest of the real-time priorities: before all that have none.
_PRIORITY = 1


@contextmanager
def punctual(clock: Clock) -> Iterator[None]:
    """While it lasts, this thread comes first, turns are short, and garbage is soon found.

    It is looked for in what is made meanwhile only: all that the modules of a run have loaded is
    some 70,000 objects and more, and going through them takes tens of milliseconds. Where the clock
    is not the machine's, nothing can be late, and all stays as it is.
    """
    if not isinstance(clock, MonotonicClock):
        yield
        return
    turn_s = sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(_TURN_S)
    try:
        with first_in_line():
            yield
    finally:
        sys.setswitchinterval(turn_s)
        gc.unfreeze()


@contextmanager
def first_in_line() -> Iterator[None]:
    """While it lasts, this thread has the processor before other programs, if it may (Linux).

    Root may, and whoever has a limit for real-time priorities. So have the threads that it starts:
    one of the interpreter's threads that has to wait for the processor keeps all others waiting.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(PermissionError):
        if before[0] == os.SCHED_OTHER:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_PRIORITY))
    try:
        yield
    finally:
        with suppress(PermissionError):
            os.sched_setscheduler(0, *before)
