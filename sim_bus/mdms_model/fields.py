"""Open-loop velocity fields: the reference of every wheel, from its place and direction alone.

A field is a vector at every place of the table; a wheel gets the part along its direction. The
numbers are references r of the paper's law V = G (r - v), not speeds: a free wheel runs at (a/b) r.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from mdms_model.arrays import Floats


class FieldError(ValueError):
    """A field is not known or lacks what it needs."""


@dataclass(frozen=True, slots=True)
class FieldShape:
    """What sets one field of a kind apart from another; each kind uses what it needs.

    `speed_m_s` is the greatest reference, `velocity_m_s` and `yaw_rate_rad_s` are a twist about
    `centre_m`, `ratio` is the weaker over the stronger axis of an ellipse, and `table_m_s` holds
    one reference per wheel, by cell, then by axis.
    """

    speed_m_s: float = 0.0
    heading_rad: float = 0.0
    centre_m: tuple[float, float] = (0.0, 0.0)
    velocity_m_s: tuple[float, float] = (0.0, 0.0)
    yaw_rate_rad_s: float = 0.0
    ratio: float = 0.5
    table_m_s: tuple[float, ...] = ()


Field = Callable[[Floats, Floats, FieldShape], Floats]


def _along(vectors: Floats, directions: Floats) -> Floats:
    """Component of each vector along the direction of its wheel."""
    return np.asarray((vectors * directions).sum(axis=1))


def _heading(shape: FieldShape) -> Floats:
    return np.array([np.cos(shape.heading_rad), np.sin(shape.heading_rad)])


def _reach_m(arms_m: Floats) -> float:
    """Distance of the outermost wheel; 1 when all are at the centre."""
    return float(np.hypot(*arms_m.T).max(initial=0.0)) or 1.0


def inward(positions_m: Floats, directions: Floats, shape: FieldShape) -> Floats:
    """Push towards the centre along x and along y at one speed [m/s] (paper, section 4.2)."""
    arms_m = positions_m - shape.centre_m
    return _along(-shape.speed_m_s * np.sign(arms_m), directions)


def uniform(positions_m: Floats, directions: Floats, shape: FieldShape) -> Floats:
    """Push along one heading at one speed [m/s]."""
    return _along(np.broadcast_to(shape.speed_m_s * _heading(shape), positions_m.shape), directions)


def rotate(positions_m: Floats, directions: Floats, shape: FieldShape) -> Floats:
    """Turn about the centre, counter-clockwise; the outermost wheel has the full speed [m/s]."""
    arms_m = positions_m - shape.centre_m
    yaw_rate_rad_s = shape.speed_m_s / _reach_m(arms_m)
    return _along(yaw_rate_rad_s * np.column_stack((-arms_m[:, 1], arms_m[:, 0])), directions)


def twist(positions_m: Floats, directions: Floats, shape: FieldShape) -> Floats:
    """Move as one rigid body: a velocity of the centre [m/s] and a yaw rate about it [rad/s]."""
    arms_m = positions_m - shape.centre_m
    turning = shape.yaw_rate_rad_s * np.column_stack((-arms_m[:, 1], arms_m[:, 0]))
    return _along(np.asarray(shape.velocity_m_s) + turning, directions)


def elliptic(positions_m: Floats, directions: Floats, shape: FieldShape) -> Floats:
    """Fall down an elliptic potential, steepest along the heading (Kavraki, ICRA 1997).

    The push grows linearly from the centre; along the heading it would reach the full speed [m/s]
    at the distance of the outermost wheel, across it `ratio` times as much.
    """
    arms_m = positions_m - shape.centre_m
    heading = _heading(shape)
    across = np.array([-heading[1], heading[0]])
    slope = np.outer(heading, heading) + shape.ratio * np.outer(across, across)
    return _along(-shape.speed_m_s / _reach_m(arms_m) * arms_m @ slope, directions)


def squeeze(positions_m: Floats, directions: Floats, shape: FieldShape) -> Floats:
    """Push at one speed [m/s] straight to a line through the centre along the heading.

    Boehringer, Donald and MacDonald's squeeze field (ICRA 1994).
    """
    heading = _heading(shape)
    across = np.array([-heading[1], heading[0]])
    side = np.sign((positions_m - shape.centre_m) @ across)
    return _along(-shape.speed_m_s * np.outer(side, across), directions)


def table(positions_m: Floats, directions: Floats, shape: FieldShape) -> Floats:
    """Give every wheel its own number [m/s]; raises FieldError unless there is one per wheel."""
    if len(shape.table_m_s) != len(directions):
        raise FieldError(
            f"the table of a field needs one speed for each of the {len(directions)} wheels, "
            f"by cell, then by axis; got {len(shape.table_m_s)}"
        )
    return np.array(shape.table_m_s, dtype=np.float64)


FIELDS: Mapping[str, Field] = {
    "inward": inward,
    "uniform": uniform,
    "rotate": rotate,
    "twist": twist,
    "elliptic": elliptic,
    "squeeze": squeeze,
    "table": table,
}


def references_m_s(name: str, positions_m: Floats, directions: Floats, shape: FieldShape) -> Floats:
    """References of all wheels [m/s], shape (W,), under the field of that name.

    Places and unit vectors have shape (W, 2). Raises FieldError for a name that no field has.
    """
    if name not in FIELDS:
        raise FieldError(f"no field is called {name!r}; there are {', '.join(FIELDS)}")
    return FIELDS[name](positions_m, directions, shape)
