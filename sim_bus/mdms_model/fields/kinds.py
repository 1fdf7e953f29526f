"""Fields that stand alone: a vector at every place of the table; a wheel gets its component.

The numbers are references r of the paper's law V = G (r - v), not speeds: a free wheel runs at
(a/b) r.
"""

from collections.abc import Callable, Mapping

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.errors import InputError
from mdms_model.scenario.motion import Part


class FieldError(InputError):
    """A field is not known or lacks a key that it needs."""


Field = Callable[[Floats, Floats, Part], Floats]


def _along(vectors: Floats, directions: Floats) -> Floats:
    """Component of each vector along the direction of its wheel."""
    return np.asarray((vectors * directions).sum(axis=1))


def _unit(angle_rad: float) -> Floats:
    return np.array([np.cos(angle_rad), np.sin(angle_rad)])


def _heading_and_across(part: Part) -> tuple[Floats, Floats]:
    heading = _unit(part.heading_rad)
    return heading, np.array([-heading[1], heading[0]])


def _turned_left(arms_m: Floats) -> Floats:
    return np.column_stack((-arms_m[:, 1], arms_m[:, 0]))


def _reach_m(arms_m: Floats) -> float:
    """Distance of the outermost wheel; 1 when all are at the centre."""
    return float(np.hypot(*arms_m.T).max(initial=0.0)) or 1.0


def inward(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Push towards the centre along x and along y at one speed [m/s] (paper, section 4.2)."""
    arms_m = positions_m - part.centre_m
    return _along(-part.speed_m_s * np.sign(arms_m), directions)


def uniform(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Push along one heading at one speed [m/s]."""
    push = part.speed_m_s * _unit(part.heading_rad)
    return _along(np.broadcast_to(push, positions_m.shape), directions)


def rotate(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Turn about the centre, counter-clockwise; the outermost wheel has the full speed [m/s]."""
    arms_m = positions_m - part.centre_m
    yaw_rate_rad_s = part.speed_m_s / _reach_m(arms_m)
    return _along(yaw_rate_rad_s * _turned_left(arms_m), directions)


def twist(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Move as one rigid body: a velocity of the centre [m/s] and a yaw rate about it [rad/s]."""
    turning = part.yaw_rate_rad_s * _turned_left(positions_m - part.centre_m)
    return _along(np.asarray(part.velocity_m_s) + turning, directions)


def linear(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """V = A p + c about the centre: a gradient A [1/s] and a velocity c of the centre [m/s].

    Under viscous sliding its net force on a parcel is that of its value at the parcel's centre of
    mass, whatever carries it (Murphey and Burdick, IJRR 2004).
    """
    arms_m = positions_m - part.centre_m
    return _along(arms_m @ np.array(part.gradient_per_s).T + part.velocity_m_s, directions)


def elliptic(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Fall down an elliptic potential, steepest along the heading (Kavraki, ICRA 1997).

    The push grows linearly from the centre; along the heading it would reach the full speed [m/s]
    at the distance of the outermost wheel, across it `ratio` times as much.
    """
    arms_m = positions_m - part.centre_m
    heading, across = _heading_and_across(part)
    slope = np.outer(heading, heading) + part.ratio * np.outer(across, across)
    return _along(-part.speed_m_s / _reach_m(arms_m) * arms_m @ slope, directions)


def squeeze(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Push at one speed [m/s] straight to a line through the centre along the heading.

    Boehringer, Donald and MacDonald's squeeze field (ICRA 1994).
    """
    _, across = _heading_and_across(part)
    side = np.sign((positions_m - part.centre_m) @ across)
    return _along(-part.speed_m_s * np.outer(side, across), directions)


def lane(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Carry along the heading at one speed [m/s], and gather to a line through the centre.

    The push across grows linearly from the line to `ratio` times the speed at the lane's edges,
    half of `width_m` away, and is as much beyond.
    """
    heading, across = _heading_and_across(part)
    half_m = (part.width_m or np.inf) / 2
    aside = np.clip((positions_m - part.centre_m) @ across / half_m, -1.0, 1.0)
    return _along(part.speed_m_s * (heading - part.ratio * np.outer(aside, across)), directions)


def diverter(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Carry along the heading as far as the centre, and along `exit_rad` beyond, at one speed."""
    heading, leaving = _unit(part.heading_rad), _unit(part.exit_rad)
    beyond = (positions_m - part.centre_m) @ heading >= 0.0
    return _along(part.speed_m_s * np.where(beyond[:, None], leaving, heading), directions)


def table(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Give every wheel its own number [m/s]; raises FieldError unless there is one per wheel."""
    if len(part.table_m_s) != len(directions):
        raise FieldError(
            f"the table of a field needs one speed for each of the {len(directions)} wheels, "
            f"by cell, then by axis; got {len(part.table_m_s)}"
        )
    return np.array(part.table_m_s, dtype=np.float64)


FIELDS: Mapping[str, Field] = {
    "inward": inward,
    "uniform": uniform,
    "rotate": rotate,
    "twist": twist,
    "elliptic": elliptic,
    "squeeze": squeeze,
    "linear": linear,
    "lane": lane,
    "diverter": diverter,
    "table": table,
}
