"""A parcel that does not get on though it is commanded to."""

from collections import deque

#: A parcel stands when it has made less than this share of the commanded way in either half of the
#: window: an edge that corrects the belief spoils one half at most.
_HALF_S = 0.4
_SHARE = 0.2
#: A commanded way too short to judge by [m].
_LEAST_M = 0.0015


class Standstill:
    """Compares the way that a parcel has made with the way it was commanded to make."""

    def __init__(self) -> None:
        self._lately: deque[tuple[float, float]] = deque()
        self._commanded_m = 0.0

    def step(self, left_m: float, speed_m_s: float, step_s: float) -> bool:
        """Take in what is left to go and the commanded speed; whether the parcel stands."""
        half = round(_HALF_S / step_s)
        self._commanded_m += speed_m_s * step_s
        self._lately.append((left_m, self._commanded_m))
        if len(self._lately) <= 2 * half:
            return False
        if len(self._lately) > 2 * half + 1:
            self._lately.popleft()
        first, middle, last = (self._lately[place] for place in (0, half, 2 * half))
        return _stands(first, middle) and _stands(middle, last)

    def clear(self) -> None:
        """Begin anew: the parcel has been still, or out of sight."""
        self._lately.clear()


def _stands(before: tuple[float, float], after: tuple[float, float]) -> bool:
    commanded_m, made_m = after[1] - before[1], before[0] - after[0]
    return commanded_m >= _LEAST_M and made_m < _SHARE * commanded_m
