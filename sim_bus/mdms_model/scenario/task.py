"""The host's jobs with the parcels, task by task: the program of a program file."""

from dataclasses import dataclass, field

from mdms_model.scenario.limit import ANGLE, PLACE, Limit

SIDE = Limit(at_least=0.01, at_most=10.0)
TASKS = ("transport", "name", "swap", "sort", "merge", "singulate", "buffer", "wait")


@dataclass(frozen=True, slots=True)
class Signal:
    """A value that comes to the program from outside, in simulated runs.

    On a real table signals come from `send_signal`, and these do not count.
    """

    name: str
    """The name that the program waits for it by."""
    value: str = ""
    """What it says."""
    time_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1e5))
    """When it comes, from the beginning of the run."""


@dataclass(frozen=True, slots=True)
class Task:
    """One task; each begins when the one before has ended, or with it if it is `beside` it.

    `do` is one of these:

    - transport: `parcel` goes to `x_m`, `y_m`, and is turned to `yaw_rad` if that is given
    - name: an unknown thing at `x_m`, `y_m` is called `parcel`, as soon as there is one. Without
      `length_m` (of a disc, its diameter) and `width_m` it is as large as sensors show it
    - swap: the two `parcels` change places
    - sort: each parcel that comes leaves by the exit for its kind
    - merge: parcels that come, wherever that is, leave by `exit`
    - singulate: those on the table, and those that come, leave by `exit` one at a time, each
      `period_s` after the one before at the soonest
    - buffer: parcels that come wait at `places` and leave by `exit`, first in, first out, or in the
      `order` of names or kinds
    - wait: for `period_s`

    `count` is after how many parcels a task with comings ends; none: it has no end.
    """

    do: str = field(metadata=Limit(choices=TASKS))
    """What it does."""
    beside: bool = False
    """Whether it begins with the task before, not after it."""
    parcel: str = ""
    """Name of the parcel of transport, or that what is named gets."""
    parcels: tuple[str, ...] = ()
    """Names of the two parcels of swap."""
    x_m: float | None = field(default=None, metadata=PLACE)
    """Place of transport, or of what is named, along x."""
    y_m: float | None = field(default=None, metadata=PLACE)
    """The same along y."""
    yaw_rad: float | None = field(default=None, metadata=ANGLE)
    """Angle of transport; none: as it comes."""
    length_m: float | None = field(default=None, metadata=SIDE)
    """Length of what is named, or its diameter; none: as sensors show it."""
    width_m: float | None = field(default=None, metadata=SIDE)
    """Its width; none: its length."""
    mass_kg: float | None = field(default=None, metadata=Limit(at_least=0.001, at_most=1000.0))
    """Its mass, as the host is to believe; none: 1 kg."""
    shape: str = field(default="rectangle", metadata=Limit(choices=("rectangle", "disc")))
    """Its outline."""
    kind: str = ""
    """Its kind, by which exits are chosen."""
    exit: str = ""
    """Name of the exit of merge, singulate and buffer."""
    places: tuple[tuple[float, float], ...] = field(default=(), metadata=PLACE)
    """Places [m] of buffer, at which parcels wait."""
    order: tuple[str, ...] = ()
    """Names or kinds of parcels, in the order in which they leave a buffer; none: as they came."""
    period_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1e5))
    """Time of wait; least time between two parcels of singulate."""
    count: int | None = field(default=None, metadata=Limit(at_least=1, at_most=1_000_000))
    """Number of parcels after which it ends; none: no end."""
