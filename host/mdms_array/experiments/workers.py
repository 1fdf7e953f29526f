"""The preparation of a process before any run; nothing of ours is imported before it.

Libraries read how many threads they may start when they are imported.
"""

import multiprocessing
import os
import signal
import sys
import threading
from importlib import import_module
from typing import Any

_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def prepare_worker(ready: Any) -> None:
    """Take one thread, leave Ctrl-C to the process that started this one, and end with it.

    The simulator is imported once; compiled code is loaded with the first run. `ready` is set then.
    Prints of runs go to stderr.
    """
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    # Stdout is for the table of all runs, or for one JSON object.
    sys.stdout = sys.stderr
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    import_module("mdms_array.simulation")
    ready.set()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)
