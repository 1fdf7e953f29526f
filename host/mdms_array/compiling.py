"""How long numba compiles, so that the wait is explained and no figure includes it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mdms_array.extras import COMPILER, require
from mdms_array.figures import REPORTED_S
from mdms_host.clock import MonotonicClock
from mdms_model.log import LOG

if TYPE_CHECKING:
    from numba.core.event import Event

NOTICE = "Compiling the simulator's inner loops; this happens once per installation."


@dataclass(slots=True)
class Compiled:
    """Time that has gone into compiling so far [s]."""

    seconds: float = 0.0


@contextmanager
def compiling_watched() -> Iterator[Compiled]:
    """Measures what is compiled meanwhile; a long time is announced on a terminal, once.

    Raises `Error` without the compiler.
    """
    require(COMPILER, "a simulation")
    # It is an extra.
    from numba.core.event import Listener, install_listener  # noqa: PLC0415

    compiled, clock = Compiled(), MonotonicClock()

    class Stopwatch(Listener):
        """Functions that others call are compiled while those are, so only the outermost counts."""

        depth = 0
        start_s = 0.0
        reported = False

        def on_start(self, event: "Event") -> None:
            if not self.depth:
                self.start_s = clock.now_s()
            self.depth += 1
            self.report()

        def on_end(self, event: "Event") -> None:
            self.report()
            self.depth -= 1
            if not self.depth:
                compiled.seconds += clock.now_s() - self.start_s

        def report(self) -> None:
            spent_s = compiled.seconds + clock.now_s() - self.start_s
            if spent_s >= REPORTED_S and not self.reported and sys.stderr.isatty():
                self.reported = True
                LOG.warning(NOTICE)

    with install_listener("numba:compile", Stopwatch()):
        yield compiled
