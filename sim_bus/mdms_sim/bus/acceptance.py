"""Acceptance filters: which identifiers a controller lets through."""

from collections.abc import Callable, Iterable


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
