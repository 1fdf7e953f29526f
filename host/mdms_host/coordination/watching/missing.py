"""Parcels that a program awaits and that are not found."""

from collections.abc import Collection, Iterator

#: A parcel is looked for so long before that is reported [s].
_FOUND_WITHIN_S = 1.5


class Missing:
    """Reports once each parcel that is awaited and not found."""

    def __init__(self) -> None:
        self._missing_s: dict[str, float] = {}

    def step(
        self, awaited: Collection[str], found: Collection[str], step_s: float
    ) -> Iterator[str]:
        """Take in which parcels have been found; those that have been looked for too long."""
        for name in sorted(awaited):
            before_s = self._missing_s.get(name, 0.0)
            self._missing_s[name] = before_s + step_s if name not in found else 0.0
            if before_s < _FOUND_WITHIN_S <= self._missing_s[name]:
                since = f"for {_FOUND_WITHIN_S:g} s"
                doubts = "is it there, as told, and every cell in its place?"
                yield f"{name} has not been found {since}: {doubts}"
