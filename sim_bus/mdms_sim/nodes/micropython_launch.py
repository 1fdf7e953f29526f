"""Runs MicroPython in this process, with a piece of memory that it shares with another.

Started by CPython as `micropython_launch.py LIBRARY MEMORY_FD OFFSET PROGRAM ARGUMENT...`; the
program finds the memory's address after its own arguments.
"""

import ctypes
import mmap
import os
import sys
from contextlib import suppress


def launch(library: str, memory_fd: str, offset: str, *command: str) -> int:
    """Returns the result of the program."""
    sys.path.append(library)
    from micropython_run import run_main  # type: ignore[import-not-found]

    _give_way()
    memory = mmap.mmap(int(memory_fd), 0)
    address = ctypes.addressof(ctypes.c_char.from_buffer(memory)) + int(offset)
    status: int = run_main(["micropython", *command, str(address)])
    return status


def _give_way() -> None:
    """Never interrupts who wakes it up: the simulation wakes all cells before it waits for one."""
    if sys.platform == "linux":
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


sys.exit(launch(*sys.argv[1:]))
