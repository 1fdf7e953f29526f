"""How long numba compiles, so that people are told why and no figure is spoilt by it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from mdms_host.cli.console import say
from mdms_host.clock import MonotonicClock

#: Nobody needs to know of less.
WORTH_TELLING_S = 0.5
NOTICE = "Compiling the simulator's inner loops; this happens once per installation."


@dataclass(slots=True)
class Compiled:
    """Time that has gone into compiling so far [s]."""

    seconds: float = 0.0


@contextmanager
def compiling_watched() -> Iterator[Compiled]:
    """Measures what is compiled meanwhile; if it takes its time, says so on a terminal, once."""
    from numba.core.event import Event, Listener, install_listener

    compiled, clock = Compiled(), MonotonicClock()

    class Watch(Listener):
        """Functions that others call are compiled while those are, so only the outermost counts."""

        depth = 0
        start_s = 0.0
        told = False

        def on_start(self, event: Event) -> None:
            if not self.depth:
                self.start_s = clock.now_s()
            self.depth += 1
            self.tell()

        def on_end(self, event: Event) -> None:
            self.tell()
            self.depth -= 1
            if not self.depth:
                compiled.seconds += clock.now_s() - self.start_s

        def tell(self) -> None:
            spent_s = compiled.seconds + clock.now_s() - self.start_s
            if spent_s >= WORTH_TELLING_S and not self.told and sys.stderr.isatty():
                self.told = True
                say(NOTICE)

    with install_listener("numba:compile", Watch()):
        yield compiled
