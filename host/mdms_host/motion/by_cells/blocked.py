"""A parcel that does not get on because its cells hold it, all the time or again and again."""

from collections.abc import Mapping
from math import inf

#: Cells at a border hold a parcel, let it go by a hair, and hold it again: a parcel that was held
#: so lately still is [s].
_AGAIN_S = 0.5
#: A parcel that has made more way since gets on [m].
_WAY_M = 0.01
#: A hold that lasts so long is reported [s].
_REPORTED_S = 1.0


class Blocked:
    """Looks at one parcel; `held` are the cells that held it last, each with those it lacked."""

    def __init__(self) -> None:
        self.held: Mapping[int, set[int]] = {}
        self._held_s = -inf
        self._since_s = inf
        self._left_m = inf
        self._reported = False

    def step(self, held: Mapping[int, set[int]], left_m: float, now_s: float) -> bool:
        """Take in the cells that hold it, and the way left; whether to report it, once each time.

        `held` is empty where no cell holds it.
        """
        if held:
            self.held, self._held_s = held, now_s
        if now_s - self._held_s > _AGAIN_S:
            self._since_s, self._reported = inf, False
        elif self._since_s == inf or left_m < self._left_m - _WAY_M:
            self._since_s, self._left_m, self._reported = now_s, left_m, False
        lasts = now_s - self._since_s >= _REPORTED_S and not self._reported
        self._reported |= lasts
        return lasts
