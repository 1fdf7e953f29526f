"""Refuses scenarios in which a parcel would tip, or is too small for cells that steer."""

from math import degrees

import numpy as np

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.motion.footholds import MARGIN_M
from mdms_host.motion.footing import Footing, Load, least_footing
from mdms_host.motion.goal import Goal
from mdms_model.array import build_wheels
from mdms_model.outline import outline_of
from mdms_model.scenario.scenario import Parcel, Scenario, in_stock

#: Cells that steer carry no parcel that is narrower than so many pitches: under a smaller one too
#: few of them see enough of it to find its place.
_LEAST_PITCHES = 2.0


def refuse_tipping(scenario: Scenario) -> None:
    """Raises `CommandError` (bad input) for a parcel that comes too near to tipping.

    So too for one that is too small for cells that steer.
    Asked of the cells alone, which carry real parcels: in the paper's fidelities a parcel may tip,
    and the physics reports it. Fields have no way that is known beforehand, so the start counts.
    """
    if scenario.run.fidelity != "firmware":
        return
    if scenario.motion.control == "cells":
        _refuse_small(scenario)
    wheel_m = build_wheels(scenario).position_m
    stock = in_stock(scenario)
    for number, parcel in enumerate(scenario.parcel):
        if parcel.name in stock:
            continue
        load = Load(outline_of(parcel), parcel.centre_of_mass_m)
        goal = goal_of(parcel) if scenario.motion.field == "goal" else None
        start = np.array([parcel.x_m, parcel.y_m, parcel.yaw_rad])
        footing = least_footing(wheel_m, load, start, goal)
        if footing.margin_m < MARGIN_M:
            raise CommandError(f"parcel.{number}: {_text(parcel, footing)}", Exit.USAGE)


def chosen_parcel(scenario: Scenario, name: str | None) -> Parcel:
    """The parcel of that name, the first without one. Raises `CommandError` for no such parcel."""
    for parcel in scenario.parcel:
        if name in (None, parcel.name):
            return parcel
    names = ", ".join(parcel.name for parcel in scenario.parcel)
    raise CommandError(f"--parcel {name}: no such parcel; there are {names}", Exit.USAGE)


def goal_of(parcel: Parcel) -> Goal | None:
    """The goal as the host steers to it, None without one; a disc stays turned as it is.

    Raises `CommandError` (bad input) for a disc that is to be turned.
    """
    goal = parcel.goal
    if goal is None:
        return None
    if parcel.shape != "disc":
        return Goal(goal.x_m, goal.y_m, goal.yaw_rad)
    if goal.yaw_rad:
        raise CommandError(
            f"goal.yaw_rad of parcel {parcel.name!r} is {goal.yaw_rad:g}, but no sensor shows how "
            "a disc is turned, so it is steered to a place only; leave yaw_rad out",
            Exit.USAGE,
        )
    return Goal(goal.x_m, goal.y_m, None)


def _refuse_small(scenario: Scenario) -> None:
    """Raises `CommandError` for a parcel that is too narrow for cells that steer."""
    least_m = _LEAST_PITCHES * scenario.array.pitch_m
    for number, parcel in enumerate(scenario.parcel):
        width_m = _width_m(parcel)
        if width_m < least_m:
            raise CommandError(
                f"parcel.{number}: {parcel.name!r} is {width_m:.3g} m wide, and cells that steer "
                f'(motion.control = "cells") carry none below {least_m:.3g} m, two pitches of the '
                "array; take a larger parcel, or have the host steer",
                Exit.USAGE,
            )


def _width_m(parcel: Parcel) -> float:
    """The least width of a parcel, whichever way it is turned [m]."""
    if parcel.shape == "disc":
        return parcel.length_m
    edges = outline_of(parcel).edges
    across_m = edges[:, 3:5] @ edges[:, :2].T
    return float(np.ptp(across_m, axis=0).min())


def _text(parcel: Parcel, footing: Footing) -> str:
    x_m, y_m, yaw_rad = footing.pose.tolist()
    if np.isinf(footing.margin_m):
        found = "no wheel is under it"
    elif footing.margin_m < 0.0:
        found = f"its centre of mass is {-1e3 * footing.margin_m:.1f} mm outside its supports"
    else:
        found = f"its centre of mass is only {1e3 * footing.margin_m:.1f} mm inside its supports"
    return (
        f"{parcel.name!r} ({parcel.shape}, {parcel.length_m:g} m x {parcel.width_m:g} m) would tip "
        f"{footing.place}, at x {x_m:.3f} m, y {y_m:.3f} m, turned by {degrees(yaw_rad):.0f} "
        f"degrees: {found}, and {1e3 * MARGIN_M:.0f} mm are needed; "
        "move its start or goal, or take a larger parcel"
    )
