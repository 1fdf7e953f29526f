"""How long numba compiles, so that people are told why and no figure is spoilt by it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from mdms_host.clock import MonotonicClock
from mdms_host.command.console import say

NOTICE = "Compiling the simulator's inner loops; this happens once per installation."


@dataclass(slots=True)
class Compiled:
    """Time that has gone into compiling so far [s]."""

    seconds: float = 0.0


@contextmanager
def compiling_watched() -> Iterator[Compiled]:
    """Measures what is compiled meanwhile; says so once, on a terminal only."""
    from numba.core.event import Event, Listener, install_listener

    compiled, clock = Compiled(), MonotonicClock()

    class Watch(Listener):
        """Functions that others call are compiled while those are, so only the outermost counts."""

        depth = 0
        start_s = 0.0

        def on_start(self, event: Event) -> None:
            if not self.depth:
                self.start_s = clock.now_s()
                if not compiled.seconds and sys.stderr.isatty():
                    say(NOTICE)
            self.depth += 1

        def on_end(self, event: Event) -> None:
            self.depth -= 1
            if not self.depth:
                compiled.seconds += clock.now_s() - self.start_s

    with install_listener("numba:compile", Watch()):
        yield compiled
