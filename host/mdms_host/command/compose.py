"""Puts host and simulator together: from a scenario to references, a coordinator and a run."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from mdms_host.command.exits import CommandError, Exit

if TYPE_CHECKING:
    from mdms_sim.record import Floats, Record
    from mdms_sim.scenario import Scenario
    from mdms_sim.simulation import BusFigures

    from mdms_host.coordinator import Coordinator
    from mdms_host.layout import Layout
    from mdms_host.program import Program
    from mdms_host.tracker import Parcel


@dataclass(frozen=True, slots=True)
class Finished:
    """A run that has ended: what it recorded, how long it took, and what a coordinator met."""

    record: "Record"
    wall_s: float
    nodes: str | None = None
    bus: "BusFigures | None" = None
    fault: str | None = None


def run_scenario(
    scenario: "Scenario",
    nodes: str = "cpython",
    progress: Callable[[float], None] | None = None,
    bus_log: Path | None = None,
) -> Finished:
    """Run a scenario in its fidelity. Raises `CommandError` for what it cannot be run with."""
    if scenario.run.fidelity == "firmware":
        return _run_firmware(scenario, nodes, progress, bus_log)
    solve = _solver(scenario.run.fidelity)
    reference_m_s = references_m_s(scenario)
    start_s = perf_counter()
    record = solve(scenario, reference_m_s)
    return Finished(record, perf_counter() - start_s)


def references_m_s(scenario: "Scenario") -> "Floats":
    """What the scenario's field tells every wheel [m/s], shape (W,)."""
    from mdms_sim.table import wheel_directions, wheel_places_m

    from mdms_host import fields

    motion = scenario.motion
    shape = fields.FieldShape(
        speed_m_s=motion.speed_m_s,
        heading_rad=motion.heading_rad,
        centre_m=motion.centre_m,
        velocity_m_s=motion.velocity_m_s,
        yaw_rate_rad_s=motion.yaw_rate_rad_s,
        ratio=motion.ratio,
        table_m_s=motion.table_m_s,
    )
    places_m, directions = wheel_places_m(scenario), wheel_directions(scenario)
    try:
        return fields.references_m_s(motion.field, places_m, directions, shape)
    except fields.FieldError as error:
        raise CommandError(f"motion.field: {error}", Exit.USAGE) from None


def layout_of(scenario: "Scenario") -> "Layout":
    """The array as the host believes it to be: here, as the scenario has it."""
    from mdms_host.layout import Layout, WheelPlace

    array, cell = scenario.array, scenario.cell
    return Layout(
        columns=array.columns,
        rows=array.rows,
        pitch_m=array.pitch_m,
        wheels=tuple(WheelPlace(wheel.direction_rad, wheel.offset_m) for wheel in cell.wheel),
        sensor_offsets_m=cell.sensor_offset_m,
    )


def coordinator_of(scenario: "Scenario") -> "Coordinator":
    """A coordinator that knows the array, the parcels' sizes and what is to be done."""
    from mdms_host.coordinator import Coordinator

    layout, parcels = layout_of(scenario), _parcels(scenario)
    program = _program(scenario, layout, parcels)
    return Coordinator(layout, program, parcels=parcels)


def _parcels(scenario: "Scenario") -> "tuple[Parcel, ...]":
    """What the host is told of the parcels: size, and where each was put if there are several."""
    from mdms_host.tracker import Parcel

    several = len(scenario.parcel) > 1
    return tuple(
        Parcel(
            name=parcel.name,
            length_m=parcel.length_m,
            width_m=parcel.width_m,
            near_m=(parcel.x_m, parcel.y_m) if several else None,
            yaw_hint_rad=parcel.yaw_rad,
        )
        for parcel in scenario.parcel
    )


def _program(scenario: "Scenario", layout: "Layout", parcels: "tuple[Parcel, ...]") -> "Program":
    from mdms_host.goal import Goal, Limits
    from mdms_host.program import FieldProgram, GoalProgram, nominal_droop

    if scenario.motion.field != "goal":
        return FieldProgram(references_m_s(scenario))
    cell = scenario.cell
    droop = nominal_droop(
        gain_vs_per_m=cell.gain_vs_per_m,
        torque_constant_nm_per_a=cell.torque_constant_nm_per_a,
        gear_ratio=cell.gear_ratio,
        wheel_radius_m=cell.wheel_radius_m,
        resistance_ohm=cell.resistance_ohm,
        damping_nms=cell.damping_nms,
    )
    goals = {
        parcel.name: Goal(parcel.goal.x_m, parcel.goal.y_m, parcel.goal.yaw_rad)
        for parcel in scenario.parcel
        if parcel.goal is not None
    }
    limits = Limits(
        speed_m_s=scenario.motion.speed_m_s,
        friction=cell.friction,
        gravity_m_s2=scenario.run.gravity_m_s2,
    )
    return GoalProgram(layout, parcels, goals, droop, limits)


def _solver(fidelity: str) -> "Callable[[Scenario, Floats], Record]":
    if fidelity == "row":
        from mdms_sim.physics.row import solve_row

        return solve_row
    from mdms_sim.physics.ideal import solve_ideal

    return solve_ideal


def _run_firmware(
    scenario: "Scenario",
    nodes: str,
    progress: Callable[[float], None] | None,
    bus_log: Path | None,
) -> Finished:
    from mdms_sim.record import Event
    from mdms_sim.simulation import simulate

    coordinator = coordinator_of(scenario)
    start_s = perf_counter()
    with bus_log.open("wb") if bus_log else nullcontext() as log:
        outcome = simulate(
            scenario,
            [coordinator],
            nodes,
            bus_log=log,
            estimates=lambda: _estimates(coordinator, scenario),
            progress=progress,
        )
    wall_s = perf_counter() - start_s
    told = [Event(time_s, "coordinator", text) for time_s, text in coordinator.events]
    outcome.record.events = sorted(outcome.record.events + told, key=lambda event: event.time_s)
    return Finished(outcome.record, wall_s, nodes, outcome.bus, coordinator.fault)


def _estimates(coordinator: "Coordinator", scenario: "Scenario") -> "Floats":
    """Poses that the coordinator believes the parcels to have, shape (P, 3), NaN where unknown."""
    import numpy as np

    believed = (coordinator.estimate(parcel.name) for parcel in scenario.parcel)
    unknown = (np.nan, np.nan, np.nan)
    return np.array([(one.x_m, one.y_m, one.yaw_rad) if one else unknown for one in believed])
