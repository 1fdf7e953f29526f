"""Whether sensors still show a parcel where it is believed to be: found, doubtful or lost."""

from enum import StrEnum
from math import inf

#: A parcel that is not shown is doubtful after this while, and lost after that [s].
_DOUBTFUL_S = 0.1
_LOST_S = 0.8


class Standing(StrEnum):
    """Standing of a belief.

    A doubtful parcel is not steered on, a lost one has no pose.
    """

    FOUND = "found"
    DOUBTFUL = "doubtful"
    LOST = "lost"


class Confirmation:
    """How long a parcel has not been shown; `standing` is what follows from it.

    A parcel that has never been found is lost from the start.
    """

    def __init__(self) -> None:
        self.standing = Standing.LOST
        self._shown_s = -inf

    def find(self, now_s: float) -> None:
        """A search has found the parcel."""
        self.standing, self._shown_s = Standing.FOUND, now_s

    def step(self, now_s: float, shown: bool) -> Standing:
        """Take in whether the sensors show it now.

        A doubtful or lost parcel stays so until a search finds it: it may be back, but elsewhere.
        """
        if self.standing is Standing.FOUND and shown:
            self._shown_s = now_s
        missing_s = now_s - self._shown_s
        if missing_s >= _LOST_S:
            self.standing = Standing.LOST
        elif missing_s >= _DOUBTFUL_S:
            self.standing = Standing.DOUBTFUL
        return self.standing
