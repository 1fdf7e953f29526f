"""Changes of a parcel, or of an unknown thing, as a report to a person."""

from dataclasses import dataclass
from enum import StrEnum

from mdms_model.arrays import Floats


class Event(StrEnum):
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
    #: A thing that was named as a parcel does not have its outline.
    MISFIT = "misfit"


@dataclass(frozen=True, slots=True)
class Change:
    """One event of one name; `pose` (x, y, yaw) where there is one [table frame].

    `size_m` is how far something unknown reaches at most, along x and y. `other` is the parcel that
    something unknown has turned out to be, or is not.
    """

    name: str
    event: Event
    pose: Floats | None = None
    size_m: tuple[float, float] | None = None
    other: str = ""
