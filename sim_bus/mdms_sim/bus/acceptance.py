"""Acceptance filters: which identifiers a controller lets through, and so who receives what."""

from collections.abc import Callable, Container, Iterable, Sequence

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import Controller

#: A flood of identifiers costs time, not memory.
REMEMBERED = 4096

FrameObserver = Callable[[Frame, int], object]
#: An observer and what it wants to see, None for everything.
Observation = tuple[FrameObserver, Container[int] | None]
Recipients = tuple[tuple[FrameObserver, ...], tuple[Controller, ...]]


class Acceptance:
    """A list of identifiers that may change while the node is on the bus."""

    def __init__(self, identifiers: Iterable[int] = ()) -> None:
        self._identifiers = frozenset(identifiers)
        self._changed: Callable[[], object] | None = None

    def __contains__(self, can_id: object) -> bool:
        return can_id in self._identifiers

    def replace(self, identifiers: Iterable[int]) -> None:
        """Lets these identifiers through from now on, and informs the bus."""
        self._identifiers = frozenset(identifiers)
        if self._changed is not None:
            self._changed()

    def on_change(self, changed: Callable[[], object]) -> None:
        """Has `changed` called after every change; for the bus, which keeps who receives what."""
        self._changed = changed


class Receivers(dict[int, Recipients]):
    """Observers and controllers by identifier; `clear` it when any of them has changed."""

    def __init__(
        self, controllers: Sequence[Controller], observations: Sequence[Observation]
    ) -> None:
        super().__init__()
        self._controllers = controllers
        self._observations = observations

    def __missing__(self, can_id: int) -> Recipients:
        if len(self) >= REMEMBERED:
            self.clear()
        observers = tuple(
            observer
            for observer, accept in self._observations
            if accept is None or can_id in accept
        )
        controllers = tuple(
            each
            for each in self._controllers
            if each.live and (each.accept is None or can_id in each.accept)
        )
        self[can_id] = recipients = observers, controllers
        return recipients
