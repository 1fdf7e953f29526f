"""How busy buses are now, from counts that only rise."""

from collections.abc import Sequence

import numpy as np

from mdms_model.arrays import Floats

#: Over at least so long [s].
_OVER_S = 0.1


class BusRates:
    """Frames a second by bus and kind (B, K), loads and error frames a second by bus (B,).

    All are 0 before they are known; error frames that nobody counts are NaN.
    """

    def __init__(self, buses: int, kinds: int) -> None:
        self.frames_per_s: Floats = np.zeros((buses, kinds))
        self.loads: Floats = np.zeros(buses)
        self.errors_per_s: Floats = np.zeros(buses)
        self._last: tuple[float, Floats, Floats, Floats] | None = None

    def count(
        self, now_s: float, frames: Sequence[Sequence[int]], busy_s: Floats, errors: Floats
    ) -> None:
        """So many frames were there by now, each bus busy for so long, with so many errors."""
        if self._last is not None and 0.0 <= now_s - self._last[0] < _OVER_S:
            return
        counted = np.array(frames, np.float64)
        if self._last is not None and now_s > self._last[0]:
            before_s, before, before_busy_s, errors_before = self._last
            passed_s = now_s - before_s
            self.frames_per_s = (counted - before) / passed_s
            self.loads = (busy_s - before_busy_s) / passed_s
            self.errors_per_s = (errors - errors_before) / passed_s
        self._last = now_s, counted, busy_s, errors
