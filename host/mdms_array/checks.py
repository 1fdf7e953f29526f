"""Refusals before a run: parcels that tip or cannot be pushed, gains without a margin."""

import math
from math import degrees

import numpy as np

from mdms_host.estimation.tracked_parcel import LEARNED_M
from mdms_host.motion.by_cells.program import LEAST_PITCHES, MOST_PITCHES
from mdms_host.motion.footholds import MARGIN_M
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.safe_goals import Footing, SupportedParcel, least_footing
from mdms_model.array import build_wheels
from mdms_model.errors import InputError
from mdms_model.loop_margin import (
    GainError,
    check_gain,
    largest_gain,
    motor_of,
    observer_for,
    phase_margin,
)
from mdms_model.outline import outline_of
from mdms_model.scenario.belief import believed
from mdms_model.scenario.run_rules import half_table_m
from mdms_model.scenario.scenario import Cell, Parcel, Scenario, in_stock


def refuse_tipping(scenario: Scenario) -> None:
    """Raises `InputError` for a parcel that comes too near to tipping.

    A parcel that is too small or too large for cells that steer is refused, too, and one of a rough
    size. So is one far larger than the table: the host could not look for it.

    Asked of the cells alone, which carry real parcels: in the paper's fidelities a parcel may tip,
    and the physics reports it. Fields have no way that is known beforehand, so the start counts.
    """
    if scenario.run.fidelity != "firmware":
        return
    _refuse_outsized(scenario)
    if scenario.motion.control == "cells":
        _refuse_small(scenario)
        _refuse_large(scenario)
        _refuse_rough(scenario)
    wheel_m = build_wheels(scenario).position_m
    stock = in_stock(scenario)
    for number, parcel in enumerate(scenario.parcel):
        if parcel.name in stock:
            continue
        load = SupportedParcel(outline_of(parcel), parcel.centre_of_mass_m)
        goal = goal_of(parcel) if scenario.motion.field == "goal" else None
        start = np.array([parcel.x_m, parcel.y_m, parcel.yaw_rad])
        footing = least_footing(wheel_m, load, start, goal)
        if footing.margin_m < MARGIN_M:
            raise InputError(f"parcel.{number}: {_text(parcel, footing)}")


def chosen_parcel(scenario: Scenario, name: str | None) -> Parcel:
    """The parcel of that name, the first without one. Raises `InputError` for no such parcel."""
    for parcel in scenario.parcel:
        if name in (None, parcel.name):
            return parcel
    names = ", ".join(parcel.name for parcel in scenario.parcel)
    if name is None:
        raise InputError("parcel is missing; this needs one")
    raise InputError(f"--parcel {name}: no such parcel; there are {names}")


def goal_of(parcel: Parcel) -> GoalPose | None:
    """The goal as the host steers to it, None without one; a disc stays turned as it is.

    Raises `InputError` for a disc that is to be turned.
    """
    goal = parcel.goal
    if goal is None:
        return None
    if parcel.shape != "disc":
        return GoalPose(goal.x_m, goal.y_m, goal.yaw_rad)
    if goal.yaw_rad:
        raise InputError(
            f"goal.yaw_rad of parcel {parcel.name!r} is {goal.yaw_rad:g}, but no sensor shows how "
            "a disc is turned, so it is steered to a place only; leave yaw_rad out"
        )
    return GoalPose(goal.x_m, goal.y_m, None)


#: Pushes of a lower friction are too small to plan with.
LEAST_FRICTION = 1e-6


def refuse_pushless(scenario: Scenario) -> None:
    """Raises `InputError` where parcels are to be steered, but no wheel is believed to push any."""
    if scenario.motion.field not in ("goal", "program"):
        return
    friction = believed(scenario).cell.friction
    if friction < LEAST_FRICTION:
        raise InputError(
            f"cell.friction is {friction:g}, so no wheel can push a parcel to its goal; give "
            f"{LEAST_FRICTION:g} or more, as in cell.friction=0.3, or an open-loop field, as in "
            "motion.field=inward"
        )
    speed_m_s = scenario.motion.speed_m_s
    if speed_m_s <= 0.0:
        raise InputError(
            f"motion.speed_m_s is {speed_m_s:g}, which is the highest speed of parcels that are "
            "steered, so none can move; give one above 0, as in motion.speed_m_s=0.3"
        )


def _refuse_small(scenario: Scenario) -> None:
    """Raises `InputError` for a parcel that is too narrow for cells that steer."""
    least_m = LEAST_PITCHES * scenario.array.pitch_m
    for number, parcel in enumerate(scenario.parcel):
        width_m = _width_m(parcel)
        if width_m < least_m:
            raise InputError(
                f"parcel.{number}: {parcel.name!r} is {width_m:.3g} m wide, and cells that steer "
                f'(motion.control = "cells") carry none below {least_m:.3g} m, two pitches of the '
                "array; take a larger parcel, or have the host steer"
            )


def _refuse_large(scenario: Scenario) -> None:
    """Raises `InputError` for a parcel that is too long for cells that steer."""
    most_m = MOST_PITCHES * scenario.array.pitch_m
    for number, parcel in enumerate(scenario.parcel):
        across_m = 2 * outline_of(parcel).radius_m
        if across_m > most_m:
            raise InputError(
                f"parcel.{number}: {parcel.name!r} is {across_m:.3g} m across, and cells that "
                f'steer (motion.control = "cells") carry none above {most_m:.3g} m, four pitches '
                "of the array; take a smaller parcel, or have the host steer"
            )


def _refuse_outsized(scenario: Scenario) -> None:
    """Raises `InputError` for a parcel of more than twice the table's size: in millimetres."""
    along_m, across_m = (2 * half_m for half_m in half_table_m(scenario))
    for number, parcel in enumerate(believed(scenario).parcel):
        reach_m = outline_of(parcel).radius_m
        if reach_m > math.hypot(along_m, across_m):
            raise InputError(
                f"parcel.{number}: {parcel.name!r} has {2 * reach_m:.3g} m from corner to corner, "
                f"but the table has {along_m:.3g} m x {across_m:.3g} m; give its size in metres"
            )


def _refuse_rough(scenario: Scenario) -> None:
    """Raises `InputError` for a size that is told too roughly to cells that steer."""
    for number, parcel in enumerate(believed(scenario).parcel):
        if parcel.shape == "rectangle" and parcel.size_spread_m > LEARNED_M:
            raise InputError(
                f"parcel.{number}: the size of {parcel.name!r} is told within "
                f"{1e3 * parcel.size_spread_m:.3g} mm (size_spread_m), but must be within "
                f'{1e3 * LEARNED_M:g} mm for cells that steer (motion.control = "cells"), since '
                "they learn none; measure it, or have the host steer"
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


MASSLESS = "none, for the wheels have no inertia: the paper's law is continuous"


def gain_limits(cell: Cell) -> dict[str, float | None]:
    """The gain [V s/m], the largest with 45 degrees of phase margin, and the gain's margin [deg].

    Massless wheels have neither (None), and a gain too small for a crossover has no margin.
    """
    largest, margin_deg = None, math.inf
    motor = motor_of(cell)
    if motor.mass_kg > 0.0:
        observer = observer_for(motor)
        largest = largest_gain(motor, observer)
        margin_deg = math.degrees(phase_margin(motor, cell.gain_vs_per_m, observer))
    return {
        "gain_vs_per_m": cell.gain_vs_per_m,
        "gain_max_vs_per_m": largest,
        "phase_margin_deg": margin_deg if math.isfinite(margin_deg) else None,
    }


def refuse_large_gain(scenario: Scenario) -> None:
    """Raises `InputError` for a gain that leaves the firmware too little margin.

    Gain and motor are those that the host believes in. The paper's fidelities have a continuous
    law, which any gain leaves stable.
    """
    cell = believed(scenario).cell
    motor = motor_of(cell)
    if scenario.run.fidelity == "firmware" and motor.mass_kg > 0.0:
        try:
            check_gain(motor, cell.gain_vs_per_m, observer_for(motor))
        except GainError as error:
            raise InputError(f"cell.gain_vs_per_m: {error}") from None
