"""The belief of one parcel at one instant, as a value."""

from dataclasses import dataclass
from enum import StrEnum
from math import sqrt

import numpy as np

from mdms_host.estimation.outlines.bottom import Bottom
from mdms_host.estimation.pose.confirmation import Standing
from mdms_model.arrays import Floats

#: A place in the plane, and a turn, are within so many standard deviations with 95 %.
_PLANE_DEVIATIONS, _TURN_DEVIATIONS = 2.45, 1.96


class Kind(StrEnum):
    """Subject of a belief: a named parcel, an unknown thing, or several things that touch."""

    PARCEL = "parcel"
    UNKNOWN = "unknown"
    HEAP = "heap"


@dataclass(frozen=True, slots=True)
class Belief:
    """A parcel that is found or doubtful [table frame; SI]; a lost parcel has no belief.

    `pose` is (x, y, yaw), `twist` its rate, shape (3,), `covariance` that of the pose, (3, 3).
    `outline` is as large as edges have shown it to be. `corrected` is whether a sensor has
    corrected the pose since the last belief. `feel` is the move (x, y, yaw) from here that would
    make the place sure enough, if it was asked for. It is None where the place is sure.

    A belief of another kind than PARCEL is an obstacle, and never steered. It rests, and its
    outline contains everything that may lie there, as far as sensors show.
    """

    name: str
    outline: Bottom
    pose: Floats
    twist: Floats
    covariance: Floats
    standing: Standing = Standing.FOUND
    corrected: bool = True
    feel: Floats | None = None
    kind: Kind = Kind.PARCEL

    @property
    def doubtful(self) -> bool:
        """Whether sensors do not show the parcel where it is believed to be."""
        return self.standing is not Standing.FOUND

    @property
    def region(self) -> tuple[float, float]:
        """How far the parcel may be from its pose, and turned, each with 95 % [m, rad]."""
        variance_m2 = np.linalg.eigvalsh(self.covariance[:2, :2])[1]
        return _PLANE_DEVIATIONS * sqrt(variance_m2), _TURN_DEVIATIONS * sqrt(self.covariance[2, 2])

    @property
    def named(self) -> bool:
        """Whether it is a parcel that somebody has given an outline and a name."""
        return self.kind is Kind.PARCEL
