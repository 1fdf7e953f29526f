"""Acceptance filters: which identifiers a controller lets through, and so who receives what."""

from collections.abc import Callable, Container, Iterable, Sequence

from mdms_protocol.frame import Frame
from mdms_sim.bus.controller import Controller

#: A flood of identifiers costs time, not memory.
REMEMBERED = 4096

FrameObserver = Callable[[Frame, int], object]
#: An observer and what it wants to see, None for everything.
Observation = tuple[FrameObserver, Container[int] | None]
Hearers = tuple[tuple[FrameObserver, ...], tuple[Controller, ...]]


class Acceptance:
    """A list of identifiers that may change while the node is on the bus."""

    def __init__(self, identifiers: Iterable[int] = ()) -> None:
        self._identifiers = frozenset(identifiers)
        self._changed: Callable[[], object] | None = None

    def __contains__(self, can_id: object) -> bool:
        return can_id in self._identifiers

    def replace(self, identifiers: Iterable[int]) -> None:
        """Lets these identifiers through from now on, and tells the bus."""
        self._identifiers = frozenset(identifiers)
        if self._changed is not None:
            self._changed()

    def on_change(self, changed: Callable[[], object]) -> None:
        """Has `changed` called after every change; for the bus, which remembers who hears what."""
        self._changed = changed


class MaskFilters:
    """Pairs of identifier and mask, as the filter banks of a controller hold them.

    A frame passes when it agrees with a pair's identifier in all bits of that pair's mask; flags
    count, so that a filter for 11-bit data frames keeps others out.
    """

    def __init__(self, filters: Iterable[tuple[int, int]]) -> None:
        self._filters = tuple(filters)

    def __contains__(self, can_id: object) -> bool:
        return isinstance(can_id, int) and any(
            (can_id ^ wanted) & mask == 0 for wanted, mask in self._filters
        )


class Receivers(dict[int, Hearers]):
    """Observers and controllers by identifier; `clear` it when any of them has changed."""

    def __init__(
        self, controllers: Sequence[Controller], observations: Sequence[Observation]
    ) -> None:
        super().__init__()
        self._controllers = controllers
        self._observations = observations

    def __missing__(self, can_id: int) -> Hearers:
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
        self[can_id] = hearers = observers, controllers
        return hearers
