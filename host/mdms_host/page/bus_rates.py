"""How busy buses are now, from counts that only rise."""

from collections.abc import Sequence

import numpy as np

from mdms_model.arrays import Floats

#: Over at least so long [s].
_OVER_S = 0.1


class BusRates:
    """Frames a second by bus and kind (B, K), and loads by bus (B,), 0 before they are known."""

    def __init__(self, buses: int, kinds: int) -> None:
        self.frames_per_s: Floats = np.zeros((buses, kinds))
        self.loads: Floats = np.zeros(buses)
        self._last: tuple[float, Floats, Floats] | None = None

    def count(self, now_s: float, frames: Sequence[Sequence[int]], busy_s: Floats) -> None:
        """So many frames were there by now, and each bus was busy for so long."""
        if self._last is not None and 0.0 <= now_s - self._last[0] < _OVER_S:
            return
        counted = np.array(frames, np.float64)
        if self._last is not None and now_s > self._last[0]:
            before_s, before, before_busy_s = self._last
            self.frames_per_s = (counted - before) / (now_s - before_s)
            self.loads = (busy_s - before_busy_s) / (now_s - before_s)
        self._last = now_s, counted, busy_s
