"""A pool that stands for the processes of `mdms sweep` and `tune`: one thread of this process.

Starting a process costs more than the runs of a test. Jobs are packed for it all the same. Real
processes are in `test_execution`, and in the test of Ctrl-C.
"""

from concurrent.futures import ThreadPoolExecutor

import pytest


class OneProcess(ThreadPoolExecutor):
    """See `execution.LocalPool`; none of its workers is ever lost."""

    def __init__(self, _workers: int) -> None:
        super().__init__(1)

    def end(self) -> None:
        self.shutdown(cancel_futures=True)


def run_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have sweeps do their runs in this process."""
    monkeypatch.setattr("mdms_array.experiments.execution.LocalPool", OneProcess)
