"""What a scenario says: the array, its cells, the parcels, the motion and the run, as plain values.

Lengths in metres in the table frame (origin at the centre of the array, x along the columns),
angles in radians, everything in SI units. `scenario_file` reads these from TOML and checks them
by their types and by the `Limit` beside each field.
"""

from dataclasses import dataclass, field
from typing import Any

from mdms_model.scenario.fault import Fault
from mdms_model.scenario.limit import (
    ANGLE,
    LENGTH,
    NOT_NEGATIVE,
    PLACE,
    POSITIVE,
    SHARE,
    Limit,
)
from mdms_model.scenario.motion import Motion
from mdms_model.scenario.stream import Exit, Stream
from mdms_model.scenario.task import Task


class ScenarioError(ValueError):
    """A scenario that cannot be run; the message is one line with key, value, limit and way out."""


FIDELITIES = ("row", "ideal", "firmware")
SHAPES = ("rectangle", "disc", "polygon")
ON_LOST_CELL = ("go_on", "hold", "stop")


@dataclass(frozen=True, slots=True)
class Array:
    """The grid of cells.

    `buses` lists the numbers of the cells on each bus, in the order of their node ids, which count
    from 1 on each; none: one bus, with node ids as the numbers. Gateways between the buses forward
    the TPDOs `forwarded` of cells at a border.
    """

    columns: int = field(metadata=Limit(at_least=1, at_most=1000))
    rows: int = field(metadata=Limit(at_least=1, at_most=1000))
    pitch_m: float = field(default=0.127, metadata=LENGTH)
    buses: tuple[tuple[int, ...], ...] = field(
        default=(), metadata=Limit(at_least=1, at_most=1_000_000)
    )
    forwarded: tuple[int, ...] = field(default=(), metadata=Limit(at_least=1, at_most=4))


@dataclass(frozen=True, slots=True)
class Wheel:
    """One driven wheel of every cell: a support point that pushes along one direction."""

    direction_rad: float = field(default=0.0, metadata=ANGLE)
    offset_m: tuple[float, float] = field(default=(0.0, 0.0), metadata=PLACE)


@dataclass(frozen=True, slots=True)
class Cell:
    """Mechanics and electrics that all cells share; spreads vary them from cell to cell by seed.

    Only `firmware` has what lies between a voltage and a push: inertia (the wheel's is about its
    own axle), supply, PWM steps and current limit (None: none). Friction of the `roller` acts along
    the wheel's axle, where it should run free. `sensor_noise` is the chance that a presence sensor
    misreads at a sample; load cells are there when their noise (standard deviation) is given.
    """

    wheel: tuple[Wheel, ...] = field(default=(Wheel(),), metadata=Limit(items=(1, 3)))
    wheel_radius_m: float = field(default=0.0254, metadata=LENGTH)
    gear_ratio: float = field(default=3.0, metadata=POSITIVE)
    torque_constant_nm_per_a: float = field(default=0.024, metadata=POSITIVE)
    resistance_ohm: float = field(default=4.0, metadata=POSITIVE)
    damping_nms: float = field(default=3.5e-6, metadata=NOT_NEGATIVE)
    rotor_inertia_kg_m2: float = field(default=0.0, metadata=NOT_NEGATIVE)
    wheel_inertia_kg_m2: float = field(default=0.0, metadata=NOT_NEGATIVE)
    gain_vs_per_m: float = field(default=10.0, metadata=NOT_NEGATIVE)
    supply_v: float = field(default=24.0, metadata=POSITIVE)
    current_limit_a: float | None = field(default=None, metadata=POSITIVE)
    friction: float = field(default=0.3, metadata=NOT_NEGATIVE)
    viscous_friction_s_per_m: float = field(default=0.0, metadata=NOT_NEGATIVE)
    roller_friction: float = field(default=0.0, metadata=NOT_NEGATIVE)
    encoder_counts_per_motor_rev: int = field(default=2000, metadata=Limit(at_least=1, at_most=1e6))
    pwm_steps: int = field(default=1000, metadata=Limit(at_least=1, at_most=1e6))
    motor_spread: float = field(default=0.0, metadata=SHARE)
    friction_spread: float = field(default=0.0, metadata=SHARE)
    load_cell_noise_n: float | None = field(default=None, metadata=NOT_NEGATIVE)
    sensor_delay_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1.0))
    sensor_noise: float = field(default=0.0, metadata=SHARE)
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


@dataclass(frozen=True, slots=True)
class Patch:
    """Cells, numbered from 1, that differ from the rest in what is given here."""

    cells: tuple[int, ...] = field(metadata=Limit(at_least=1, at_most=1_000_000))
    wheel: tuple[Wheel, ...] | None = field(default=None, metadata=Limit(items=(1, 3)))
    friction: float | None = field(default=None, metadata=NOT_NEGATIVE)


@dataclass(frozen=True, slots=True)
class Goal:
    """The pose that a parcel is steered to [table frame]."""

    x_m: float = field(metadata=PLACE)
    y_m: float = field(metadata=PLACE)
    yaw_rad: float = field(default=0.0, metadata=ANGLE)


@dataclass(frozen=True, slots=True)
class Parcel:
    """One flat-bottomed parcel and where it starts, at rest.

    Its own frame has the origin in the middle of `length_m` x `width_m`, which a rectangle fills, a
    disc touches (both are its diameter) and a polygon's `corners_m` stay within: convex, counter-
    clockwise. `inertia_kg_m2` is about the centre of mass; None: that of a uniform plate. Parcels
    of one `kind` are alike, and exits go by it; none: it is of a kind of its own.
    """

    name: str
    mass_kg: float = field(metadata=POSITIVE)
    length_m: float = field(metadata=LENGTH)
    width_m: float = field(metadata=LENGTH)
    x_m: float = field(default=0.0, metadata=PLACE)
    y_m: float = field(default=0.0, metadata=PLACE)
    yaw_rad: float = field(default=0.0, metadata=ANGLE)
    centre_of_mass_m: tuple[float, float] = field(default=(0.0, 0.0), metadata=PLACE)
    shape: str = field(default="rectangle", metadata=Limit(choices=SHAPES))
    corners_m: tuple[tuple[float, float], ...] = field(default=(), metadata=PLACE)
    inertia_kg_m2: float | None = field(default=None, metadata=POSITIVE)
    goal: Goal | None = None
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Run:
    """How, how long and with which chance the scenario is run, and what trouble it puts up with.

    Where cells are out of action the coordinator holds all parcels, for `pause_s` at most and
    `pauses` times in a minute (0: never), until they are back. `on_lost_cell` is what it does about
    one that does not come back: it stops; it holds all parcels for it, for `hold_s` at most and
    however often; or it goes on without the cell, from the start.
    """

    fidelity: str = field(default="row", metadata=Limit(choices=FIDELITIES))
    duration_s: float = field(default=20.0, metadata=Limit(above=0.0, at_most=1e5))
    step_s: float = field(default=0.001, metadata=Limit(above=0.0, at_most=1.0))
    seed: int = field(default=1, metadata=Limit(at_least=0, at_most=2**63 - 1))
    gravity_m_s2: float = field(default=9.81, metadata=Limit(above=0.0, at_most=1000.0))
    on_lost_cell: str = field(default="stop", metadata=Limit(choices=ON_LOST_CELL))
    pauses: int = field(default=3, metadata=Limit(at_least=0, at_most=1000))
    pause_s: float = field(default=5.0, metadata=Limit(above=0.0, at_most=1000.0))
    hold_s: float = field(default=60.0, metadata=Limit(above=0.0, at_most=1e5))


@dataclass(frozen=True, slots=True)
class Wire:
    """The bus, and how often the host has the cells exchange setpoints and speeds on it.

    Two periods must fit into the 50 ms for which a cell goes on by a setpoint.
    """

    bitrate: int = field(default=1_000_000, metadata=Limit(at_least=10_000, at_most=1_000_000))
    sync_period_s: float = field(default=0.01, metadata=Limit(at_least=0.005, at_most=0.02))


@dataclass(frozen=True, slots=True)
class Scenario:
    """One experiment."""

    title: str
    array: Array
    cell: Cell = field(default_factory=Cell)
    parcel: tuple[Parcel, ...] = field(default=(), metadata=Limit(items=(1, 10_000)))
    motion: Motion = field(default_factory=Motion)
    run: Run = field(default_factory=Run)
    patch: tuple[Patch, ...] = ()
    wire: Wire = field(default_factory=Wire)
    fault: tuple[Fault, ...] = ()
    stream: tuple[Stream, ...] = ()
    exit: tuple[Exit, ...] = ()
    task: tuple[Task, ...] = ()
    #: What the host takes for true where it is not; see `belief`.
    belief: dict[str, Any] = field(default_factory=dict, hash=False)


def in_stock(scenario: Scenario) -> set[str]:
    """The names of the parcels that are not on the table at the start."""
    return {name for stream in scenario.stream for name in stream.parcels}


def goal_of(scenario: Scenario, parcel: Parcel) -> Goal | None:
    """Where a parcel is steered to, if the motion steers at all."""
    return parcel.goal if scenario.motion.field == "goal" else None
