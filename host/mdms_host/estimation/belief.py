"""What is believed of one parcel at one instant, as a value."""

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
    """What a belief is of: a parcel with a name, something unknown, or several that touch."""

    PARCEL = "parcel"
    UNKNOWN = "unknown"
    HEAP = "heap"


@dataclass(frozen=True, slots=True)
class Belief:
    """A parcel that is found, or doubtful; what is lost has no belief [table frame; SI].

    `pose` is (x, y, yaw), `twist` its rate, shape (3,), `covariance` that of the pose, (3, 3), and
    `outline` is as large as edges have shown it to be. `corrected` is whether a sensor has
    corrected the pose since the last belief. `feel` is the move (x, y, yaw) from here that would
    make the place sure enough, where that was asked for; None where it is.

    What is not of the kind PARCEL is an obstacle, and never steered: its outline contains whatever
    lies there, as far as sensors show, and it rests.
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
