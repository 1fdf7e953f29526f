"""What the host is to do with the parcels, task by task: the program of a program file."""

from dataclasses import dataclass, field

from mdms_model.scenario.limit import ANGLE, PLACE, Limit

TASKS = ("transport", "swap", "sort", "merge", "singulate", "buffer", "wait")


@dataclass(frozen=True, slots=True)
class Task:
    """One task; each begins when the one before has ended, or with it if it is `beside` it.

    By what it is to `do`:

    - transport: `parcel` goes to `x_m`, `y_m`, and is turned to `yaw_rad` if that is given
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
    """Name of the parcel of transport."""
    parcels: tuple[str, ...] = ()
    """Names of the two parcels of swap."""
    x_m: float | None = field(default=None, metadata=PLACE)
    """Place of transport along x."""
    y_m: float | None = field(default=None, metadata=PLACE)
    """The same along y."""
    yaw_rad: float | None = field(default=None, metadata=ANGLE)
    """Angle of transport; none: as it comes."""
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
