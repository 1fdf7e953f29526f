"""Refusals before a run: parcels that tip, gains without a margin, buses too full."""

import math
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import degrees

import numpy as np

from mdms_host.coordination.run_state import Timing
from mdms_host.estimation.tracked_parcel import LEARNED_M
from mdms_host.motion.by_cells.program import LEAST_PITCHES, MOST_PITCHES
from mdms_host.motion.footholds import MARGIN_M
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.safe_goals import Footing, SupportedParcel, least_footing
from mdms_model.array import build_wheels
from mdms_model.buses import (
    CROWDED,
    OVERLOADED,
    SENT_AT_SYNC,
    BusTraffic,
    address_cells,
    foreign_nodes,
)
from mdms_model.errors import InputError
from mdms_model.log import LOG
from mdms_model.loop_margin import (
    GainError,
    WheelMotor,
    check_gain,
    largest_gain,
    observer_for,
    phase_margin,
)
from mdms_model.motor import drive_of, rim_mass_kg
from mdms_model.outline import outline_of
from mdms_model.scenario.belief import believed
from mdms_model.scenario.run_rules import half_table_m
from mdms_model.scenario.scenario import Cell, Parcel, Scenario, Wire, in_stock


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


def refuse_pushless(scenario: Scenario) -> None:
    """Raises `InputError` where parcels are to be steered, but no wheel is believed to push any."""
    if scenario.motion.field not in ("goal", "program"):
        return
    friction = believed(scenario).cell.friction
    if friction == 0.0:
        raise InputError(
            "cell.friction is 0, so no wheel can push a parcel to its goal; give a friction above "
            "0, as in cell.friction=0.3, or an open-loop field, as in motion.field=inward"
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


def motor_of(cell: Cell) -> WheelMotor:
    """The motor of a scenario's cells as its wheel's rim sees it."""
    drive = drive_of(cell)
    return WheelMotor(
        force_n_per_a=drive.ke,
        resistance_ohm=cell.resistance_ohm,
        damping_n_s_per_m=drive.be,
        mass_kg=rim_mass_kg(cell),
    )


#: The longest period that leaves a lost frame in time for the cells' setpoint time-out of 50 ms.
SYNC_PERIOD_MOST_S = 0.02


@dataclass(frozen=True, slots=True)
class _Users:
    """The load of one bus:

    its cells, the side that steers, and the frames forwarded to it at every SYNC.
    """

    cells: int
    control: str = "host"
    forwarded: int = 0
    name: str = ""

    def load(self, wire: Wire) -> float:
        return _traffic(wire, self.control).load(self.cells, self.forwarded)


def timing_of(wire: Wire) -> Timing:
    """The coordinator's periods on the wire of a scenario."""
    return Timing(sync_period_s=wire.sync_period_s)


def refuse_overload(scenario: Scenario) -> None:
    """Raises `InputError` for more cells than a bus carries with their host."""
    users, wire = _busiest(scenario), scenario.wire
    if scenario.run.fidelity == "firmware" and users.load(wire) > OVERLOADED:
        raise InputError(
            f"array: a run of {_needed(users, wire)}, and above {OVERLOADED:.0%} cells fall "
            f"silent; {_help(users, wire)}"
        )


def check_load(scenario: Scenario, options: Namespace) -> None:
    """Refuse a scenario on the bus that python-can's options name, or warn. Raises `InputError`.

    Without a bit rate among them the scenario's own counts.
    """
    bitrate = getattr(options, "bitrate", None) or scenario.wire.bitrate
    scenario = replace(scenario, wire=replace(scenario.wire, bitrate=bitrate))
    refuse_overload(scenario)
    _warn(_busiest(scenario), scenario.wire)


def load_of(cells: int, wire: Wire, control: str = "host") -> float:
    """The share of a bus that so many cells need at most, steered by the host or by themselves."""
    return _Users(cells, control).load(wire)


def warn_of_load(cells: int, wire: Wire) -> None:
    """State the demand of a run with so many cells on a bus where they are crowded."""
    _warn(_Users(cells), wire)


def _busiest(scenario: Scenario) -> _Users:
    return max(_users(scenario), key=lambda users: users.load(scenario.wire))


def _users(scenario: Scenario) -> Iterator[_Users]:
    array, control = scenario.array, scenario.motion.control
    addresses = address_cells(array.columns * array.rows, array.buses)
    if addresses.bus_count == 1:
        yield _Users(len(addresses.buses), control)
        return
    tpdos = len(SENT_AT_SYNC.intersection(array.forwarded))
    foreign = foreign_nodes(array.columns, array.rows, addresses) if tpdos else None
    for bus in range(addresses.bus_count):
        cells = addresses.buses.count(bus)
        forwarded = tpdos * len(foreign[bus]) if foreign else 0
        yield _Users(cells, control, forwarded, f"bus {bus}")


def _warn(users: _Users, wire: Wire) -> None:
    load = users.load(wire)
    if load > OVERLOADED:
        limit, what = OVERLOADED, "cells fall silent, and a run is refused"
    elif load > CROWDED:
        limit, what = CROWDED, "answers queue"
    else:
        return
    needed = _needed(users, wire)
    LOG.warning(f"warning: a run of {needed}; above {limit:.0%} {what}: {_help(users, wire)}")


def wire_of(options: Namespace) -> Wire:
    """The wire that python-can's options name, with the cells' own bit rate where they do not."""
    return Wire(getattr(options, "bitrate", None) or Wire().bitrate)


def _traffic(wire: Wire, control: str) -> BusTraffic:
    timing = timing_of(wire)
    return BusTraffic(
        wire.bitrate,
        timing.sync_period_s,
        timing.heartbeat_period_s,
        timing.status_period_s,
        control,
    )


def _needed(users: _Users, wire: Wire) -> str:
    besides = f" and {users.forwarded} forwarded frames" if users.forwarded else ""
    return (
        f"{users.cells} cells{besides} needs {users.load(wire):.0%} of {users.name or 'a bus'} at "
        f"{wire.bitrate / 1e3:g} kbit/s"
    )


def _help(users: _Users, wire: Wire) -> str:
    """Ways to bring the load down, as far as they do."""
    ways = [f"{_traffic(wire, users.control).most_cells()} cells a bus"]
    slower = replace(wire, sync_period_s=SYNC_PERIOD_MOST_S)
    may_be_slower = users.control == "host" and wire.sync_period_s < SYNC_PERIOD_MOST_S
    if may_be_slower and users.load(slower) <= OVERLOADED:
        ways.append(f"a slower SYNC (wire.sync_period_s = {SYNC_PERIOD_MOST_S:g})")
    if wire.bitrate < Wire().bitrate:
        ways.append("a higher bit rate")
    return f"take {' or '.join(ways)}"
