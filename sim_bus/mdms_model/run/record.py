"""The results of a run in memory: sampled state of parcels and wheels, and events.

Wheels are ordered by cell, then by axis: wheel `w` of a two-wheel cell is cell `w // 2 + 1`, axis
`w % 2 + 1`. A `History` holds samples as they come, in a memory that may be bounded.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.errors import InputError


class Contact(IntEnum):
    """The contact of a wheel under a parcel; the paper's three greys, sliding by direction.

    On hardware no sensor shows it: unknown.
    """

    NONE = 0
    ROLLING = 1
    SLIDING_FORWARD = 2
    SLIDING_BACKWARD = 3
    UNKNOWN = 4


class RecordFileError(InputError):
    """A file holds no record of ours."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at one instant.

    `kind` is one of 'support', 'contact', 'reversal', 'tip', 'touch', 'arrival', 'exit', 'solver',
    'fault', 'coordinator', 'link', 'violation'.
    """

    time_s: float
    kind: str
    detail: str
    parcel: str | None = None
    cell: int | None = None
    axis: int | None = None

    @property
    def text(self) -> str:
        """The detail, and the parcel that it is about."""
        return self.detail if self.parcel is None else f"{self.parcel}: {self.detail}"


@dataclass(frozen=True, slots=True)
class Tile:
    """A square of the table [m; table frame], and the parcels that pass over it, in their order."""

    x_m: float
    y_m: float
    side_m: float
    parcels: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """The plan from a time on: goals, the ways of parcels under way, and tiles they need.

    `ways` are poses (K, 3) by name, x, y and yaw linear between them [m, m, rad; table frame], and
    `due_s` when each of them is planned [s], (K,). `goals` are poses (3,) by name, the yaw NaN
    where any will do.
    """

    time_s: float
    ways: Mapping[str, Floats]
    tiles: tuple[Tile, ...] = ()
    due_s: Mapping[str, Floats] = field(default_factory=dict)
    goals: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(slots=True)
class Record:
    """Sampled history of T instants, P parcels and W wheels.

    `pose` [m, m, rad] and `twist` [m/s, m/s, rad/s] are of shape (T, P, 3) in the table frame and
    are those of the parcels' geometric centres; `estimate` is the coordinator's belief of `pose`,
    NaN where it had none. The wheels' arrays are of shape (T, W), speeds those of the surface;
    `contact` holds `Contact` codes. `slip_m_s` is the surface's speed over the parcel on the wheel,
    positive ahead, 0 without contact; None where nobody has worked it out. Unknown values are NaN,
    such as the truth on hardware, and so are pose and twist of a parcel that is away.

    Where C cells steered, their estimates on the bus: `identity` of the parcel that a cell is at, 0
    for none, `state` as in `mdms_protocol.neighbours.frames` (near, promised, under), both of shape
    (T, C), and `belief` of that parcel's pose, shape (T, C, 3), NaN where the cell has none; else
    None. `presence` has the bits of the cells' sensors (T, C), from sensor 0 on, as they reported
    them; None without a bus. `plans` are those of a host that steers parcels, in their order.
    """

    time_s: Floats
    pose: Floats
    twist: Floats
    reference_m_s: Floats
    speed_m_s: Floats
    voltage_v: Floats
    normal_n: Floats
    force_n: Floats
    contact: NDArray[np.int8]
    estimate: Floats | None = None
    events: list[Event] = field(default_factory=list)
    slip_m_s: Floats | None = None
    identity: NDArray[np.int8] | None = None
    state: NDArray[np.int8] | None = None
    belief: Floats | None = None
    presence: NDArray[np.uint8] | None = None
    plans: list[Plan] = field(default_factory=list)

    @property
    def is_belief(self) -> bool:
        """Whether only the coordinator's beliefs are known, and no true pose."""
        return self.estimate is not None and not np.isfinite(self.pose).any()


#: Samples that a run without an end of its own keeps: five minutes at 100 a second.
MOST_SAMPLES = 30_000


class History:
    """Times and named arrays, offered one sample after another.

    With `most` samples kept, every second one is dropped, and from then on only every second one is
    taken: the whole course stays, at half the rate.
    """

    def __init__(self, most: int | None = None) -> None:
        self._most = most
        self._offered = 0
        self._stride = 1
        self._samples: list[tuple[float, dict[str, Any]]] = []

    def takes(self) -> bool:
        """Whether the sample that is offered now is to be appended."""
        offered, self._offered = self._offered, self._offered + 1
        return offered % self._stride == 0

    def append(self, time_s: float, **values: Any) -> None:
        """Keep a sample; its arrays belong to the history from now on."""
        self._samples.append((time_s, values))
        if len(self._samples) == self._most:
            del self._samples[1::2]
            self._stride *= 2

    def copy(self) -> "History":
        """The same samples, and none that another thread appends meanwhile."""
        copied = History(self._most)
        copied._samples = list(self._samples)
        return copied

    @property
    def time_s(self) -> Floats:
        """When the samples were taken, shape (T,)."""
        return np.array([time_s for time_s, _ in self._samples])

    def columns(self) -> dict[str, Any]:
        """The samples by name, each of shape (T, ...)."""
        names = self._samples[0][1] if self._samples else ()
        return {name: np.array([row[name] for _, row in self._samples]) for name in names}


_BY = "leaves by "
_WRONG = ", which is not for its kind"


def leaving(time_s: float, parcel: str, exit_name: str, wrong: bool) -> Event:
    """A parcel leaves by an exit; `wrong` is whether that is for other kinds."""
    return Event(time_s, "exit", f"{_BY}{exit_name}" + _WRONG * wrong, parcel=parcel)


def exit_of(event: Event) -> str:
    """The exit by which a parcel has left."""
    return event.detail.removeprefix(_BY).removesuffix(_WRONG)


def is_wrong(event: Event) -> bool:
    """Whether that exit is for other kinds."""
    return event.detail.endswith(_WRONG)
