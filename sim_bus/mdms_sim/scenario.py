"""What a scenario says: the array, its cells, the parcels, the motion and the run, as plain values.

Lengths in metres in the table frame (origin at the centre of the array, x along the columns),
angles in radians, everything in SI units. `scenario_file` reads these from TOML and checks them.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Array:
    """The grid of cells."""

    columns: int
    rows: int
    pitch_m: float = 0.127


@dataclass(frozen=True, slots=True)
class Wheel:
    """One driven wheel of every cell: a support point that pushes along one direction."""

    direction_rad: float = 0.0
    offset_m: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Cell:
    """Mechanics and electrics that all cells share; spreads vary them from cell to cell by seed."""

    wheel: tuple[Wheel, ...] = (Wheel(),)
    wheel_radius_m: float = 0.0254
    gear_ratio: float = 3.0
    torque_constant_nm_per_a: float = 0.024
    resistance_ohm: float = 4.0
    damping_nms: float = 3.5e-6
    rotor_inertia_kg_m2: float = 0.0
    gain_vs_per_m: float = 10.0
    supply_v: float = 24.0
    friction: float = 0.3
    viscous_friction_s_per_m: float = 0.0
    encoder_counts_per_motor_rev: int = 2000
    pwm_steps: int = 1000
    motor_spread: float = 0.0
    sensor_offset_m: tuple[tuple[float, float], ...] = (
        (0.0, 0.0),
        (0.03175, 0.03175),
        (-0.03175, 0.03175),
        (-0.03175, -0.03175),
        (0.03175, -0.03175),
    )


@dataclass(frozen=True, slots=True)
class Goal:
    """The pose that a parcel is steered to [table frame]."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Parcel:
    """One flat-bottomed rectangular parcel and where it starts, at rest."""

    name: str
    mass_kg: float
    length_m: float
    width_m: float
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    centre_of_mass_m: tuple[float, float] = (0.0, 0.0)
    goal: Goal | None = None


@dataclass(frozen=True, slots=True)
class Motion:
    """What the wheels are told to do."""

    field: str = "inward"
    speed_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Run:
    """How, how long and with which chance the scenario is simulated."""

    fidelity: str = "row"
    duration_s: float = 20.0
    step_s: float = 0.001
    seed: int = 1
    gravity_m_s2: float = 9.81


@dataclass(frozen=True, slots=True)
class Scenario:
    """One experiment."""

    title: str
    array: Array
    cell: Cell = field(default_factory=Cell)
    parcel: tuple[Parcel, ...] = ()
    motion: Motion = field(default_factory=Motion)
    run: Run = field(default_factory=Run)
