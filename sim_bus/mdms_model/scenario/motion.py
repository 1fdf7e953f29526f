"""The motion of a scenario: a field of references, sums and regions, goals, a program."""

from dataclasses import dataclass
from dataclasses import field as member

from mdms_model.scenario.limit import ANGLE, LENGTH, PLACE, SPEED, Limit

#: Fields that stand alone, and those that are made of parts.
KINDS = (
    *("inward", "uniform", "rotate", "elliptic", "twist", "squeeze"),
    *("linear", "lane", "diverter", "table"),
)
COMPOSED = ("sum", "regions")
FIELDS = (*KINDS, *COMPOSED)
CONTROLS = ("host", "cells")
POLICIES = ("rolling", "sliding")
REGIONS = ("rectangle", "polygon", "disc")


@dataclass(frozen=True, slots=True)
class Region:
    """Some of the table [m; table frame]: a rectangle, a polygon or a disc.

    `corners_m` are two opposite ones of a rectangle along x and y, or all of a simple polygon in
    turn. A wheel on the border of two that touch is in one of them: a border at the left or below
    belongs to a region.
    """

    shape: str = member(metadata=Limit(choices=REGIONS))
    """Its outline."""
    corners_m: tuple[tuple[float, float], ...] = member(
        default=(), metadata=Limit(at_least=-1000.0, at_most=1000.0, items=(0, 100))
    )
    """Two opposite corners of a rectangle, or all of a polygon in turn."""
    centre_m: tuple[float, float] = member(default=(0.0, 0.0), metadata=PLACE)
    """Centre of a disc."""
    radius_m: float | None = member(default=None, metadata=LENGTH)
    """Radius of a disc, which needs it."""


@dataclass(frozen=True, slots=True)
class Part:
    """One field of references, in a region of the table or, without one, all over it.

    Each field uses some of the other keys: `heading_rad` uniform, elliptic, squeeze, lane and
    diverter, `velocity_m_s` twist and linear, `yaw_rate_rad_s` twist, `ratio` elliptic and lane,
    `table_m_s` table, `gradient_per_s` linear, `width_m` lane, `exit_rad` diverter; `part` sum,
    which adds its parts, and regions, where the first part with the wheel in its region holds.
    """

    # This class has a field called `field`, so the function needs another name here.
    field: str = member(metadata=Limit(choices=FIELDS))
    """The field of references."""
    speed_m_s: float = member(default=0.0, metadata=SPEED)
    """Largest reference of the field; of goals and programs, a cap on the speed."""
    heading_rad: float = member(default=0.0, metadata=ANGLE)
    """Direction of uniform, elliptic, squeeze, lane and diverter."""
    centre_m: tuple[float, float] = member(default=(0.0, 0.0), metadata=PLACE)
    """Centre of the field."""
    velocity_m_s: tuple[float, float] = member(default=(0.0, 0.0), metadata=SPEED)
    """Velocity of twist and linear at the centre."""
    yaw_rate_rad_s: float = member(default=0.0, metadata=SPEED)
    """Yaw rate of twist."""
    ratio: float = member(default=0.5, metadata=Limit(at_least=0.0, at_most=1.0))
    """Reference across the heading over that along it, of elliptic and lane."""
    table_m_s: tuple[float, ...] = member(default=(), metadata=SPEED)
    """References of table, wheel by wheel."""
    gradient_per_s: tuple[tuple[float, float], tuple[float, float]] = member(
        default=((0.0, 0.0), (0.0, 0.0)), metadata=SPEED
    )
    """Gradient of linear: rows of the matrix by which places give references."""
    width_m: float | None = member(default=None, metadata=LENGTH)
    """Width of lane, which needs it."""
    exit_rad: float = member(default=0.0, metadata=ANGLE)
    """Direction of diverter beyond its centre."""
    region: Region | None = None
    """Where the field holds; none: all over the table."""
    part: tuple["Part", ...] = member(default=(), metadata=Limit(items=(0, 100)))
    """Parts of sum, which adds them, and of regions, of which the first that holds counts."""


@dataclass(frozen=True, slots=True)
class Motion(Part):
    """The motion of the wheels: by a field, by goals of parcels, or by a program's tasks.

    Goals are steered to under the `control` of the host, or of the cells by themselves; these
    `go_on` without the host, or stop.

    A field's references are the paper's r, unless `compensate_droop` makes them the speeds of the
    wheels' surfaces. `policy` keeps them where, by the paper's limits, all wheels roll (eq 14) or
    slide at equilibrium (eq 15). `outside` says whether others are refused or clamped. Wheels with
    less than `light_share` of an even share of the weight are left out of rolling: in the plane
    there nearly always are poses in which one wheel carries next to nothing.
    """

    field: str = member(default="inward", metadata=Limit(choices=(*FIELDS, "goal", "program")))
    """A field of references, goals of parcels, or a program."""
    control: str = member(default="host", metadata=Limit(choices=CONTROLS))
    """Who closes the loop of goals."""
    go_on: bool = False
    """Whether cells that steer go on without the host."""
    policy: str | None = member(default=None, metadata=Limit(choices=POLICIES))
    """Keeps references where all wheels roll (eq 14) or slide (eq 15); none: any."""
    outside: str = member(default="refuse", metadata=Limit(choices=("refuse", "clamp")))
    """What becomes of references outside the policy."""
    light_share: float = member(default=0.0, metadata=Limit(at_least=0.0, at_most=1.0))
    """Wheels with less than this share of an even load are left out of rolling."""
    compensate_droop: bool = False
    """Whether numbers are speeds of wheels' surfaces, not references."""
