"""Parcels that have goals and are not found."""

from collections.abc import Collection, Iterable, Iterator

#: A parcel is looked for so long before that is reported [s].
_FOUND_WITHIN_S = 1.5


class Missing:
    """Watches the parcels of these names, and reports once each that is not found."""

    def __init__(self, names: Iterable[str]) -> None:
        self._missing_s = dict.fromkeys(names, 0.0)

    def step(self, found: Collection[str], step_s: float) -> Iterator[str]:
        """Take in which parcels have been found; those that have been looked for too long."""
        for name, before_s in self._missing_s.items():
            self._missing_s[name] = before_s + step_s if name not in found else 0.0
            if before_s < _FOUND_WITHIN_S <= self._missing_s[name]:
                since = f"for {_FOUND_WITHIN_S:g} s"
                doubts = "is it there, as told, and every cell in its place?"
                yield f"{name} has not been found {since}: {doubts}"
