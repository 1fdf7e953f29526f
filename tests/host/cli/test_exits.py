"""A signal ends the command wherever its main thread stands, in numba's C code too."""

import os
import signal
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

from mdms_host.cli.exits import Interrupted, Terminated, ended_by_signals
from mdms_model.compiled import compiled

PATIENCE_S = 5.0
RECORDS = np.zeros(3, dtype=[("mass_kg", float)]).view(np.recarray)


@compiled
def total(records):
    result = 0.0
    for each in records:
        result += each.mass_kg
    return result


@contextmanager
def not_ignored(number):
    """The caller of the tests may ignore the signal, as nohup does; then the command does too."""
    before = signal.getsignal(number)
    if before == signal.SIG_IGN:
        signal.signal(number, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(number, before)


def until_ended(sent):
    end_s = time.monotonic() + PATIENCE_S
    while not sent or time.monotonic() < end_s:
        total(RECORDS)


@pytest.mark.parametrize(
    ("number", "error"),
    [
        (signal.SIGTERM, Terminated),
        (signal.SIGHUP, Terminated),
        (signal.SIGINT, Interrupted),
    ],
)
def test_signal_while_attributes_of_records_are_looked_up_is_not_lost(number, error):
    """Numba asks records for an attribute at each call, and drops what that raises."""
    total(RECORDS)
    sent = []

    def send_once(frame, event, _argument):
        if not sent and event == "call" and "records" in frame.f_globals["__name__"]:
            sent.append(frame.f_code.co_name)
            os.kill(os.getpid(), number)

    with not_ignored(number), ended_by_signals():
        sys.setprofile(send_once)
        try:
            with pytest.raises(error):
                until_ended(sent)
        finally:
            sys.setprofile(None)
    assert sent == ["__getattribute__"]
