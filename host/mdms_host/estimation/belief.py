"""What is believed of one parcel at one instant, as a value."""

from dataclasses import dataclass

from mdms_host.estimation.bottom import Bottom
from mdms_host.estimation.confirmation import Standing
from mdms_model.arrays import Floats


@dataclass(frozen=True, slots=True)
class Belief:
    """A parcel that is found, or doubtful; what is lost has no belief [table frame; SI].

    `pose` is (x, y, yaw), `twist` its rate, shape (3,), `covariance` that of the pose, (3, 3), and
    `outline` is as large as edges have shown it to be. `corrected` is whether a sensor has
    corrected the pose since the last belief. `feel_rad` is the turn that would make the place sure
    enough, where that was asked for; None where it is.
    """

    name: str
    outline: Bottom
    pose: Floats
    twist: Floats
    covariance: Floats
    standing: Standing = Standing.FOUND
    corrected: bool = True
    feel_rad: float | None = None

    @property
    def doubtful(self) -> bool:
        """Whether sensors do not show the parcel where it is believed to be."""
        return self.standing is not Standing.FOUND
