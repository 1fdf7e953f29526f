"""A scenario: the array, its cells, parcels, streams, tasks, motion and the run, as plain values.

Lengths in metres in the table frame (origin at the centre of the array, x along the columns),
angles in radians, everything in SI units. `scenario.file` reads these from TOML and checks them by
their types and by the `Limit` beside each field.
"""

from dataclasses import dataclass, field
from math import inf
from re import fullmatch
from typing import Any

from mdms_model.errors import InputError
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.limit import (
    ANGLE,
    LENGTH,
    MASS,
    NOT_NEGATIVE,
    PLACE,
    POSITIVE,
    SHARE,
    Limit,
)
from mdms_model.scenario.motion import Motion

SIDES = ("east", "north", "west", "south")


@dataclass(frozen=True, slots=True)
class Stream:
    """Parcels of a stock that are set down one after another, at rest, at one place.

    The next parcel is the first in stock, by the order of `parcels` (their names), of a kind that
    the seed draws from those in stock. It is set down within `spread_m` and `spread_rad` of the
    place as soon as `clear_m` around it is free, but no sooner than `period_s` after the one
    before, and never more than `most` in all (None: no end). A parcel that has left by an exit is
    in stock again. `parcels` start in stock, wherever the scenario puts them.
    """

    parcels: tuple[str, ...] = field(metadata=Limit(items=(1, 63)))
    """Names of the parcels in stock."""
    x_m: float = field(default=0.0, metadata=PLACE)
    """Place along x where they are set down."""
    y_m: float = field(default=0.0, metadata=PLACE)
    """The same along y."""
    yaw_rad: float = field(default=0.0, metadata=ANGLE)
    """Their angle there."""
    start_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1e5))
    """When the first may come."""
    period_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1e5))
    """Least time between two."""
    clear_m: float = field(default=0.02, metadata=Limit(at_least=0.0, at_most=1.0))
    """How much around the place is free before the next comes."""
    spread_m: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=0.1))
    """Largest deviation from the place, drawn by seed."""
    spread_rad: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=0.5))
    """Largest deviation from the angle, drawn by seed."""
    most: int | None = field(default=None, metadata=Limit(at_least=1, at_most=1_000_000))
    """How many come in all; none: no end."""


@dataclass(frozen=True, slots=True)
class Exit:
    """A stretch of one edge of the table, over which parcels leave.

    The conveyor there takes a parcel when its centre of mass has passed the last support, and lies
    between `from_m` and `to_m` along the edge [table frame]. `kinds` are those that are to leave by
    it; empty: any.
    """

    name: str
    """What tasks and programs call it."""
    side: str = field(metadata=Limit(choices=SIDES))
    """The edge of the table."""
    from_m: float = field(default=-1000.0, metadata=PLACE)
    """Beginning of its stretch, along the edge."""
    to_m: float = field(default=1000.0, metadata=PLACE)
    """End of its stretch."""
    kinds: tuple[str, ...] = ()
    """Kinds of parcels that leave by it; none: any that are sent there."""

    def out_m(self, x_m: float, y_m: float, last_m: float) -> float:
        """How far a centre of mass is beyond the last support, at `last_m` to this side [m].

        -inf where it is not within the stretch.
        """
        along_m, across_m = (y_m, x_m) if self.side in ("east", "west") else (x_m, y_m)
        if not self.from_m <= along_m <= self.to_m:
            return -inf
        return (across_m if self.side in ("east", "north") else -across_m) - last_m


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


class ScenarioError(InputError):
    """A scenario that cannot be run; the message is one line with key, value, limit and way out."""


FIDELITIES = ("row", "ideal", "firmware")
SHAPES = ("rectangle", "disc", "polygon")
#: How much larger a parcel may be than its drawing, on either side (one standard deviation) [m].
DRAWN_M = 0.0005
ON_LOST_CELL = ("go_on", "hold", "stop")
STOP_FORMS = ("short", "category_1")


@dataclass(frozen=True, slots=True)
class Array:
    """The grid of cells; node ids count from 1 on each bus."""

    columns: int = field(metadata=Limit(at_least=1, at_most=1000))
    """Cells along x."""
    rows: int = field(metadata=Limit(at_least=1, at_most=1000))
    """Cells along y."""
    pitch_m: float = field(default=0.127, metadata=LENGTH)
    """Distance between the centres of neighbouring cells."""
    buses: tuple[tuple[int, ...], ...] = field(
        default=(), metadata=Limit(at_least=1, at_most=1_000_000)
    )
    """Numbers of the cells on each bus, in the order of their node ids; none: one bus."""
    forwarded: tuple[int, ...] = field(default=(), metadata=Limit(at_least=1, at_most=4))
    """TPDOs that gateways carry to the other bus of a border, 1 to 4; none: no gateways."""
    coded_places: bool = False
    """Whether connectors tell cells their places, so that a cell elsewhere refuses to start."""


@dataclass(frozen=True, slots=True)
class Wheel:
    """One driven wheel of every cell: a support point that pushes along one direction."""

    direction_rad: float = field(default=0.0, metadata=ANGLE)
    """Direction of its push, from x."""
    offset_m: tuple[float, float] = field(default=(0.0, 0.0), metadata=PLACE)
    """Its contact point, from the cell's centre."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Mechanics and electrics that all cells share; spreads vary them from cell to cell by seed.

    Only `firmware` has the steps between a voltage and a push: inertia, supply, PWM steps and
    current limit.
    """

    wheel: tuple[Wheel, ...] = field(default=(Wheel(),), metadata=Limit(items=(1, 3)))
    """The driven wheels; `firmware` takes one or two, `row` one along x."""
    wheel_radius_m: float = field(default=0.0254, metadata=LENGTH)
    """Radius of a wheel."""
    gear_ratio: float = field(default=3.0, metadata=POSITIVE)
    """Turns of the motor in one turn of the wheel."""
    torque_constant_nm_per_a: float = field(default=0.024, metadata=POSITIVE)
    """Torque constant of the motor, Km; its back-EMF constant too."""
    resistance_ohm: float = field(default=4.0, metadata=POSITIVE)
    """Resistance of the motor's coil, Rm."""
    damping_nms: float = field(default=3.5e-6, metadata=NOT_NEGATIVE)
    """Viscous damping of the motor's shaft, Bm."""
    rotor_inertia_kg_m2: float = field(default=0.0, metadata=NOT_NEGATIVE)
    """Inertia of the rotor, about the motor's shaft."""
    wheel_inertia_kg_m2: float = field(default=0.0, metadata=NOT_NEGATIVE)
    """Inertia of the wheel, about its own axle."""
    gain_vs_per_m: float = field(default=10.0, metadata=POSITIVE)
    """Gain of the speed loop, G, in V = G (r - v)."""
    supply_v: float = field(default=24.0, metadata=POSITIVE)
    """Supply of the motors; no voltage exceeds it."""
    current_limit_a: float | None = field(default=None, metadata=POSITIVE)
    """Current at which a bridge limits; none: it does not."""
    friction: float = field(default=0.3, metadata=NOT_NEGATIVE)
    """Coulomb friction between wheel and parcel, mu."""
    viscous_friction_s_per_m: float = field(default=0.0, metadata=NOT_NEGATIVE)
    """Above 0: the sliding force is this times N times the slip, in place of mu N."""
    roller_friction: float = field(default=0.0, metadata=NOT_NEGATIVE)
    """Coulomb friction along the wheel's axle, where its rollers run free."""
    encoder_counts_per_motor_rev: int = field(default=2000, metadata=Limit(at_least=1, at_most=1e6))
    """Counts of the encoder in one turn of the motor."""
    pwm_steps: int = field(default=1000, metadata=Limit(at_least=1, at_most=1e6))
    """Steps of the PWM between 0 and the supply."""
    motor_spread: float = field(default=0.0, metadata=SHARE)
    """Largest deviation of a motor's constants from these, as a share, drawn by seed."""
    friction_spread: float = field(default=0.0, metadata=SHARE)
    """Largest deviation of a cell's friction from the above, as a share, drawn by seed."""
    load_cell_noise_n: float | None = field(default=None, metadata=NOT_NEGATIVE)
    """Standard deviation of the load cells' readings; none: there are no load cells."""
    sensor_delay_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1.0))
    """Time from a change over a presence sensor to the change of its output."""
    sensor_noise: float = field(default=0.0, metadata=SHARE)
    """Probability that a presence sensor misreads at a sample."""
    sensor_offset_m: tuple[tuple[float, float], ...] = field(
        default=(
            (0.0, 0.0),
            (0.03175, 0.03175),
            (-0.03175, 0.03175),
            (-0.03175, -0.03175),
            (0.03175, -0.03175),
        ),
        metadata=Limit(items=(1, 5)),
    )
    """Places of the presence sensors, from the cell's centre."""


@dataclass(frozen=True, slots=True)
class Patch:
    """Cells, numbered from 1, that differ from the rest in these keys."""

    cells: tuple[int, ...] = field(metadata=Limit(at_least=1, at_most=1_000_000))
    """Numbers of the cells that differ."""
    wheel: tuple[Wheel, ...] | None = field(default=None, metadata=Limit(items=(1, 3)))
    """Their wheels, in place of `cell.wheel`."""
    friction: float | None = field(default=None, metadata=NOT_NEGATIVE)
    """Their friction, in place of `cell.friction`."""


@dataclass(frozen=True, slots=True)
class Goal:
    """The pose that a parcel is steered to [table frame]."""

    x_m: float = field(metadata=PLACE)
    """Place of the middle of the parcel's outline along x."""
    y_m: float = field(metadata=PLACE)
    """The same along y."""
    yaw_rad: float = field(default=0.0, metadata=ANGLE)
    """Its angle there."""


@dataclass(frozen=True, slots=True)
class Parcel:
    """One flat-bottomed parcel and where it starts, at rest.

    Its own frame has the origin in the middle of `length_m` x `width_m`, which a rectangle fills, a
    disc touches and a polygon stays within.
    """

    name: str
    """What tasks, streams and faults call it: a name of its own, of 64 characters at most."""
    mass_kg: float = field(metadata=MASS)
    """Mass."""
    length_m: float = field(metadata=LENGTH)
    """Extent along its own x; the diameter of a disc."""
    width_m: float = field(metadata=LENGTH)
    """Extent along its own y; the diameter of a disc."""
    x_m: float = field(default=0.0, metadata=PLACE)
    """Place of the middle of its outline along x, at the start."""
    y_m: float = field(default=0.0, metadata=PLACE)
    """The same along y."""
    yaw_rad: float = field(default=0.0, metadata=ANGLE)
    """Its angle at the start."""
    centre_of_mass_m: tuple[float, float] = field(default=(0.0, 0.0), metadata=PLACE)
    """Centre of mass, in its own frame."""
    shape: str = field(default="rectangle", metadata=Limit(choices=SHAPES))
    """Its outline."""
    corners_m: tuple[tuple[float, float], ...] = field(default=(), metadata=PLACE)
    """Corners of a polygon in its own frame, convex and counterclockwise."""
    inertia_kg_m2: float | None = field(default=None, metadata=Limit(at_least=1e-12, at_most=1e6))
    """Inertia about its centre of mass; none: that of a uniform plate."""
    goal: Goal | None = None
    """Where it is steered to, with `motion.field = "goal"`."""
    kind: str = ""
    """Parcels of one kind are alike, and exits sort by it; empty: a kind of its own."""
    size_spread_m: float = field(default=DRAWN_M, metadata=Limit(above=0.0, at_most=0.1))
    """How exact its size is told to the host, on either side, as one standard deviation."""


@dataclass(frozen=True, slots=True)
class Run:
    """How, how long and with which chance the scenario is run, and what trouble it puts up with.

    Where cells are out of action the coordinator holds all parcels until they are back. If a cell
    does not come back, it stops, holds all parcels for it, or goes on without it at once.
    """

    fidelity: str = field(default="row", metadata=Limit(choices=FIDELITIES))
    """The paper's row, ideal wheels in the plane, or cells with firmware, bus and host."""
    duration_s: float = field(default=20.0, metadata=Limit(at_least=1e-3, at_most=1e5))
    """Simulated time; of `mdms run` the time limit, without its bring-up."""
    step_s: float = field(default=0.001, metadata=Limit(above=0.0, at_most=1.0))
    """Step of the samples (row), of the physics (ideal: 10 ms at most; firmware: 1 ms)."""
    seed: int = field(default=1, metadata=Limit(at_least=0, at_most=2**63 - 1))
    """Seed of all that is drawn."""
    gravity_m_s2: float = field(default=9.81, metadata=Limit(at_least=1e-6, at_most=1000.0))
    """Acceleration of gravity."""
    on_lost_cell: str = field(default="stop", metadata=Limit(choices=ON_LOST_CELL))
    """What becomes of a run whose cell does not come back."""
    pauses: int = field(default=3, metadata=Limit(at_least=0, at_most=1000))
    """How often in a minute all parcels are held until cells are back; 0: never."""
    pause_s: float = field(default=5.0, metadata=Limit(above=0.0, at_most=1000.0))
    """How long they are held at most."""
    hold_s: float = field(default=60.0, metadata=Limit(above=0.0, at_most=1e5))
    """The same with `on_lost_cell = "hold"`, however often."""


@dataclass(frozen=True, slots=True)
class Wire:
    """The bus, and how often the host has the cells exchange setpoints and speeds on it.

    Two periods must fit into the 50 ms for which a cell goes on by a setpoint.
    """

    bitrate: int = field(default=1_000_000, metadata=Limit(at_least=10_000, at_most=1_000_000))
    """Bit rate of every bus, in bit/s; a bit lasts a whole number of nanoseconds."""
    sync_period_s: float = field(default=0.01, metadata=Limit(at_least=0.005, at_most=0.02))
    """Time between SYNC frames, and so between setpoints."""


@dataclass(frozen=True, slots=True)
class Stop:
    """The limits of the table's emergency stop: lighter and slower parcels stay on the table.

    It is measured on the table, or taken from docs/emergency-stop.md.
    """

    form: str = field(metadata=Limit(choices=STOP_FORMS))
    """A contact shorts each motor, or its bridge does for 1 s before the supply is cut."""
    mass_kg: float = field(metadata=POSITIVE)
    """The heaviest parcel; heavier ones are refused."""
    speed_m_s: float = field(metadata=POSITIVE)
    """The fastest motion; faster ones are refused."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """One experiment."""

    title: str
    """One line of plain text."""
    array: Array
    """The grid of cells."""
    cell: Cell = field(default_factory=Cell)
    """What all cells share."""
    parcel: tuple[Parcel, ...] = field(default=(), metadata=Limit(items=(0, 10_000)))
    """The parcels; none: an empty table."""
    motion: Motion = field(default_factory=Motion)
    """What the wheels do."""
    run: Run = field(default_factory=Run)
    """How it is run."""
    patch: tuple[Patch, ...] = ()
    """Cells that differ from the rest."""
    wire: Wire = field(default_factory=Wire)
    """The buses."""
    fault: tuple[Fault, ...] = ()
    """What goes wrong."""
    stream: tuple[Stream, ...] = ()
    """Parcels that come."""
    exit: tuple[Exit, ...] = ()
    """Where parcels leave."""
    task: tuple[Task, ...] = ()
    """A program, task by task."""
    signal: tuple[Signal, ...] = ()
    """What comes to the program from outside."""
    stop: Stop | None = None
    """What the emergency stop holds; none: nothing is refused for it."""
    #: The host's beliefs where they are not true; see `belief`.
    belief: dict[str, Any] = field(default_factory=dict, hash=False)
    """What the host takes for true: keys of `cell`, and tables of parcels by name."""


#: A name fits a line of a terminal, and the texts of a line's protocols.
LONGEST_NAME = 64


def name_fault(name: str) -> str | None:
    """Why no parcel can have this name; None where one can.

    `unknown-1` and so on are the host's names for things that nobody has named.
    """
    if not name.strip() or not name.isprintable():
        return "must be a word to name it by"
    if fullmatch(r"unknown-\d+", name):
        return "is a name that the host gives to unknown things; take another"
    if len(name) > LONGEST_NAME:
        return f"has {len(name)} characters; take {LONGEST_NAME} at most"
    return None


def in_stock(scenario: Scenario) -> set[str]:
    """The names of the parcels that are not on the table at the start."""
    return {name for stream in scenario.stream for name in stream.parcels}


def goal_of(scenario: Scenario, parcel: Parcel) -> Goal | None:
    """Where a parcel is steered to, if the motion steers at all."""
    return parcel.goal if scenario.motion.field == "goal" else None
