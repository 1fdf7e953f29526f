"""The belief of one parcel at one instant, its standing, and its changes, as values.

Sensors confirm a belief: the parcel is found, doubtful or lost.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import inf, radians, sqrt

import numpy as np

from mdms_host.estimation.footprint import Footprint
from mdms_model.arrays import Floats

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


#: A place in the plane, and a turn, are within so many standard deviations with 95 %.
_PLANE_DEVIATIONS, _TURN_DEVIATIONS = 2.45, 1.96
#: The place of a parcel that has arrived is to be known so well, with 95 % [m, rad].
_UNSURE_M, _UNSURE_RAD = 0.005, radians(2.0)


class BeliefKind(StrEnum):
    """Subject of a belief: a named parcel, an unknown thing, or several things that touch."""

    PARCEL = "parcel"
    UNKNOWN = "unknown"
    HEAP = "heap"


@dataclass(frozen=True, slots=True)
class Belief:
    """A parcel that is found or doubtful [table frame; SI]; a lost parcel has no belief.

    `pose` is (x, y, yaw), `twist` its rate, shape (3,), `covariance` that of the pose, (3, 3).
    `outline` is as large as edges have shown it to be. `corrected` is whether a sensor has
    corrected the pose since the last belief. `feel` are moves (x, y, yaw) from here that would make
    the place surer, best first, if they were asked for. There are none where it is sure. `noisy` is
    whether sensors are wrong too often to show the place. `unseen` is whether no speeds came for a
    while before the last ones: the twist has changed in all of that time.

    A belief of another kind than PARCEL is an obstacle, and never steered. It rests, and its
    outline contains everything that may lie there, as far as sensors show.
    """

    name: str
    outline: Footprint
    pose: Floats
    twist: Floats
    covariance: Floats
    standing: Standing = Standing.FOUND
    corrected: bool = True
    feel: tuple[Floats, ...] = ()
    kind: BeliefKind = BeliefKind.PARCEL
    noisy: bool = False
    unseen: bool = False

    @property
    def doubtful(self) -> bool:
        """Whether sensors do not show the parcel where it is believed to be."""
        return self.standing is not Standing.FOUND

    @property
    def region(self) -> tuple[float, float]:
        """How far the parcel may be from its pose, and turned, each with 95 % [m, rad]."""
        variance_m2 = np.linalg.eigvalsh(self.covariance[:2, :2])[1]
        return _PLANE_DEVIATIONS * sqrt(variance_m2), _TURN_DEVIATIONS * sqrt(self.covariance[2, 2])

    def is_sure(self, *, turned: bool, times: float = 1.0) -> bool:
        """Whether it is known within 5 mm, and if the turn matters within 2 degrees, with 95 %.

        Both bounds count so many `times`.
        """
        off_m, off_rad = self.region
        return off_m <= times * _UNSURE_M and not (turned and off_rad > times * _UNSURE_RAD)

    @property
    def named(self) -> bool:
        """Whether it is a parcel that somebody has given an outline and a name."""
        return self.kind is BeliefKind.PARCEL


class BeliefEvent(StrEnum):
    """Kind of a change; the first three are standings of a parcel's belief."""

    FOUND = "found"
    DOUBTFUL = "doubtful"
    LOST = "lost"
    #: A parcel has left over its exit, or was taken off as announced.
    DEPARTED = "departed"
    #: Sensors are covered by nothing that is known.
    APPEARED = "appeared"
    #: The same, and it is more than one parcel, which cannot be told apart.
    HEAPED = "heaped"
    #: An unknown thing is there no more.
    CLEARED = "cleared"
    #: An unknown thing is a parcel that has been found.
    EXPLAINED = "explained"
    #: Another thing was taken for a parcel that was to come.
    WITHDRAWN = "withdrawn"
    #: Two that sensors cannot tell apart both lay elsewhere than told: which is which is a guess.
    GUESSED = "guessed"
    #: A thing that was named as a parcel does not have its outline.
    MISFIT = "misfit"


@dataclass(frozen=True, slots=True)
class BeliefChange:
    """One event of one name; `pose` (x, y, yaw) where there is one [table frame].

    `size_m` is how far something unknown reaches at most, along x and y. `other` is the parcel that
    something unknown has turned out to be, or is not, or that looks like this one.
    """

    name: str
    event: BeliefEvent
    pose: Floats | None = None
    size_m: tuple[float, float] | None = None
    other: str = ""


@dataclass(frozen=True, slots=True)
class Gain:
    """Rates of twists [table frame; m/s2, rad/s2], shape (3,).

    `gained` is the rate at which the wheels have become faster. `missing` is the part that their
    pushes do not explain: while it lasts, all wheels slip.
    """

    gained: Floats
    missing: Floats
