"""How a person is told of parcels that cells steer: which cells, and only of what lasts, once."""

from collections.abc import Collection
from math import inf

#: A state that lasts so long is reported [s].
REPORTED_S = 1.0


class Lasting:
    """Something that is reported once each time that it has held for a while."""

    def __init__(self, after_s: float = REPORTED_S) -> None:
        self._after_s = after_s
        self._since_s: float | None = None

    def step(self, holds: bool, now_s: float) -> bool:
        """Take in whether it holds; whether to report it."""
        if not holds:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = now_s
        elif now_s - self._since_s >= self._after_s:
            self._since_s = inf
            return True
        return False


def cells_text(numbers: Collection[int]) -> str:
    """How notices call these cells."""
    listed = ", ".join(map(str, sorted(numbers)))
    return f"cell {listed}" if len(numbers) == 1 else f"cells {listed}"
