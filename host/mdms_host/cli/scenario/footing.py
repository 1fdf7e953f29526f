"""Refuses scenarios in which a parcel would tip: where it starts, at its goal, or on its way."""

from math import degrees

import numpy as np

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.motion.footholds import MARGIN_M
from mdms_host.motion.footing import Footing, Load, least_footing
from mdms_host.motion.goal import Goal
from mdms_model.array import build_wheels
from mdms_model.outline import outline_of
from mdms_model.scenario.scenario import Parcel, Scenario, in_stock


def refuse_tipping(scenario: Scenario) -> None:
    """Raises `CommandError` (bad input) for a parcel that comes too near to tipping.

    Asked of the cells alone, which carry real parcels: in the paper's fidelities a parcel may tip,
    and the physics reports it. Fields have no way that is known beforehand, so the start counts.
    """
    if scenario.run.fidelity != "firmware":
        return
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
