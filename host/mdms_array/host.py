"""From a scenario to the host's own objects: array, parcels, program, settings of the cells."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import hypot, inf, pi
from typing import Any

import numpy as np

from mdms_array.bus_load import timing_of
from mdms_array.checks import goal_of
from mdms_host.can_link.sdo_client import Setting
from mdms_host.commissioning.parameters import BY_NAME
from mdms_host.coordination.bring_up import ExpectedCells
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.recovery import OnLostCell, Policy
from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.by_cells.sending import CellsMotion
from mdms_host.motion.carrying import AHEAD_M
from mdms_host.motion.goal import GoalPose, Limits
from mdms_host.motion.program import ByCells, FieldProgram, Program
from mdms_host.motion.trajectory.pushes import Mass
from mdms_host.motion.trajectory.traction import Traction, wheel_drives_of
from mdms_host.programs.newcomers import Comings, Infeed
from mdms_host.programs.order import Gate
from mdms_host.programs.program import CellsTableProgram, Main, Member, TableProgram
from mdms_host.programs.script import failure_text
from mdms_host.programs.table import Table
from mdms_host.programs.tasks import main_of
from mdms_host.programs.traffic.by_cells import CellsTraffic
from mdms_host.programs.traffic.by_host import TableTraffic
from mdms_host.programs.traffic.dispatch import KeptFree, PlanExecutor, VirtualExecutor
from mdms_host.programs.traffic.ride import Load
from mdms_host.routes.route import TrapezoidPace
from mdms_host.routes.support import Shape
from mdms_model.array import last_support_m
from mdms_model.arrays import Floats
from mdms_model.buses import Addresses, address_cells
from mdms_model.errors import InputError
from mdms_model.fields import ReferenceCommand, accepted
from mdms_model.log import LOG
from mdms_model.loop_margin import largest_gain, motor_of, observer_for
from mdms_model.motor import drive_of
from mdms_model.parcel import parcel_records
from mdms_model.scenario.belief import believed
from mdms_model.scenario.rules import check_rules
from mdms_model.scenario.run_rules import half_table_m
from mdms_model.scenario.scenario import Cell, Exit, Run, Scenario, Stop, Stream, in_stock
from mdms_protocol import indices, pdo
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import OutOfRangeError, steps_per_unit


@dataclass(frozen=True, slots=True)
class Cells:
    """The cells one by one, as far as they differ: node ids, settings and serial numbers by number.

    Without node ids a cell has that of its place on its bus. A cell without a serial number here
    may have any.
    """

    node_ids: tuple[int, ...] = ()
    settings: Mapping[int, tuple[Setting, ...]] = field(default_factory=dict)
    serials: Mapping[int, int] = field(default_factory=dict)


def gains_vs_per_m(scenario: Scenario, cells: Cells) -> Floats:
    """The gain that each wheel has by its cell's own settings, else the scenario's, shape (W,)."""
    axes, array = len(scenario.cell.wheel), scenario.array
    gains = np.full((array.columns * array.rows, axes), scenario.cell.gain_vs_per_m)
    for number, settings in cells.settings.items():
        own = {(each.index, each.sub): each.value for each in settings}
        for axis in range(axes):
            gain = BY_NAME[f"axis{axis + 1}.gain"]
            if gain.place in own:
                gains[number - 1, axis] = gain.si(own[gain.place])
    return gains.ravel()


def addresses_of(scenario: Scenario, cells: Cells) -> Addresses:
    """Bus and node id of each cell, with node ids of their own where the cells have any."""
    array = scenario.array
    addresses = address_cells(array.columns * array.rows, array.buses)
    return replace(addresses, node_ids=cells.node_ids) if cells.node_ids else addresses


def references_m_s(scenario: Scenario) -> Floats:
    """References of all wheels [m/s], shape (W,); what its policy clamps is said on stderr.

    Raises FieldError, PolicyError and `ScenarioError`.
    """
    command = accepted(scenario)
    if command.outside:
        LOG.warning(f"{command}; clamped")
    return command.set_m_s


def command_figures(scenario: Scenario, command: ReferenceCommand) -> dict[str, Any]:
    """The wheels' references by a field and by its policy, for JSON."""
    speeds_m_s = abs(command.asked_m_s)
    moving_m_s = speeds_m_s[speeds_m_s > 0.0]
    return {
        "field": scenario.motion.field,
        "slowest_m_s": float(moving_m_s.min(initial=speeds_m_s.max())),
        "fastest_m_s": float(speeds_m_s.max()),
        "policy": scenario.motion.policy,
        "limit_m_s": None if command.bound is None else command.bound.limit_m_s,
        "limited_by": None if command.bound is None else command.bound.parcel,
        "wheels": len(speeds_m_s),
        "wheels_outside": command.outside,
        "outside": scenario.motion.outside if command.outside else None,
    }


#: Along which axis a side lies outward, and with which sign.
_OUTWARD = {"east": (0, 1), "west": (0, -1), "north": (1, 1), "south": (1, -1)}


def table_program(
    scenario: Scenario,
    parcels: tuple[Parcel, ...],
    masses: Mapping[str, Mass],
    traction: Traction,
    *,
    main: Main | None = None,
    executor: PlanExecutor | None = None,
) -> TableProgram:
    """The program of a scenario's goals or tasks, or `main`, with all that it needs to be run."""
    named = {parcel.name: parcel for parcel in parcels}
    loads = _loads(named, masses)
    pace = TrapezoidPace(scenario.motion.speed_m_s, _acceleration_m_s2(traction, loads))
    traffic = TableTraffic(
        traction,
        pace,
        executor or VirtualExecutor(),
        loads,
        kept_free=[
            _kept_free(number, stream, named) for number, stream in enumerate(scenario.stream)
        ],
        told=_told(parcels, scenario),
        hangs=scenario.motion.field == "goal",
    )
    infeeds = [_infeed(number, scenario, named) for number in range(len(scenario.stream))]
    gates = [gate_of(each, scenario, traction.layout) for each in scenario.exit]
    table, main = Table(half_table_m(scenario), gates, traffic), main or main_of(scenario.task)
    program = TableProgram(main, table, _members(scenario), traffic, Comings(infeeds))
    if (goals := goals_of(scenario)) is not None:
        program.keep_goals(goals)
    return program


def cells_program(
    scenario: Scenario,
    parcels: tuple[Parcel, ...],
    masses: Mapping[str, Mass],
    cells: CellsProgram,
    *,
    layout: Layout,
    main: Main | None = None,
    executor: PlanExecutor | None = None,
) -> CellsTableProgram:
    """The same for cells that steer."""
    loads = _loads({parcel.name: parcel for parcel in parcels}, masses)
    hangs = scenario.motion.field == "goal"
    traffic = CellsTraffic(layout, executor or VirtualExecutor(), loads, cells, hangs=hangs)
    table, main = Table(half_table_m(scenario), (), traffic), main or main_of(scenario.task)
    program = CellsTableProgram(main, table, _members(scenario), traffic)
    if (goals := goals_of(scenario)) is not None:
        program.keep_goals(goals)
    return program


def _loads(named: Mapping[str, Parcel], masses: Mapping[str, Mass]) -> dict[str, Load]:
    return {name: Load(parcel.footprint, masses[name]) for name, parcel in named.items()}


def _told(parcels: tuple[Parcel, ...], scenario: Scenario) -> dict[str, Floats]:
    """Where parcels were put that may be elsewhere by some mm, and are to be found there."""
    stock = in_stock(scenario)
    return {
        parcel.name: np.array([*parcel.near_m, parcel.yaw_hint_rad])
        for parcel in parcels
        if parcel.near_m is not None and parcel.name not in stock
    }


def _members(scenario: Scenario) -> list[Member]:
    stock = in_stock(scenario)
    return [
        Member(one.name, one.kind, one.length_m, one.width_m, one.shape, one.name not in stock)
        for one in scenario.parcel
    ]


def gate_of(each: Exit, scenario: Scenario, layout: Layout) -> Gate:
    """An exit as the host takes it: where its last support is, and how far it reaches."""
    axis, _ = outward = _OUTWARD[each.side]
    half_m = half_table_m(scenario)[1 - axis]
    return Gate(
        each.name,
        outward,
        last_support_m(layout.wheel_positions_m, each.side),
        max(each.from_m, -half_m),
        min(each.to_m, half_m),
        each.kinds,
    )


def _acceleration_m_s2(traction: Traction, loads: Mapping[str, Load]) -> float:
    """The acceleration for plans: the least that any parcel is sped up with along x or y."""
    agilities = [
        traction.agility(load.footprint, load.mass) for load in dict.fromkeys(loads.values())
    ]
    along = np.eye(3)[:2]
    known = [one.acceleration_m_s2(axis) for one in agilities for axis in along]
    return min(known, default=TrapezoidPace.acceleration_m_s2)


def _infeed(number: int, scenario: Scenario, named: Mapping[str, Parcel]) -> Infeed:
    stream = scenario.stream[number]
    stock: dict[str, tuple[Parcel, ...]] = {}
    for one in scenario.parcel:
        if one.name in stream.parcels:
            kind = one.kind or one.name
            stock[kind] = (*stock.get(kind, ()), named[one.name])
    return Infeed(f"infeed {number}", _infeed_pose(stream), stock)


def _kept_free(number: int, stream: Stream, named: Mapping[str, Parcel]) -> KeptFree:
    footprints = (named[name].footprint for name in stream.parcels)
    largest = max(footprints, key=lambda footprint: footprint.reach_m)
    return KeptFree(f"infeed {number}", _infeed_pose(stream), Shape(largest))


def _infeed_pose(stream: Stream) -> Floats:
    return np.array([stream.x_m, stream.y_m, stream.yaw_rad])


def programmed(scenario: Scenario) -> Scenario:
    """The scenario with a program for its motion, in place of a field or goals.

    Raises ScenarioError where none can run, as in a fidelity without cells.
    """
    if scenario.motion.field == "program":
        return scenario
    scenario = replace(scenario, motion=replace(scenario.motion, field="program"))
    check_rules(scenario)
    return scenario


def has_failed(coordinator: Coordinator) -> bool:
    """Whether a run's program has ended by an error in it."""
    return isinstance(coordinator.program, TableProgram) and coordinator.program.failed


def break_off(coordinator: Coordinator) -> str | None:
    """Break off what is left of a run's program once the run is over: `finally` in it runs now.

    Returns the message of an error that comes of that, if any.
    """
    program = coordinator.program
    error = program.driver.stop() if isinstance(program, TableProgram) else None
    if error is None:
        return None
    return f"the program failed as the run ended: {failure_text(error)}"


def late_text(coordinator: Coordinator) -> str:
    """Why a run has not come to its end, though no parcel is known to be off its goal."""
    program = coordinator.program
    if isinstance(program, TableProgram) and not program.keeps_goals:
        return f"the program has not come to its end{waits_text(coordinator)}"
    late = [name for name in coordinator.goals if name not in coordinator.arrived_s]
    return (
        f"{' and '.join(late) or 'a parcel'} is near its goal, but does not count as arrived: "
        "sensors do not show its place well enough for it to come to rest"
    )


def waits_text(coordinator: Coordinator) -> str:
    """Reasons why a run's program waits, as part of a message; empty where it does not."""
    program = coordinator.program
    if not isinstance(program, TableProgram) or program.keeps_goals:
        return ""
    missing = [name for name in sorted(program.awaits) if coordinator.estimate(name) is None]
    if missing:
        return f": it has not begun, for {' and '.join(missing)} cannot be found on the table"
    places = program.waits_at
    return f": it waits in {' and '.join(places)}" if places else ""


#: As much as a cell comes with, but never more than half the supply.
UNDERVOLTAGE_V = 10.0


def coordinator_of(
    scenario: Scenario,
    cells: Cells | None = None,
    *,
    main: Main | None = None,
    executor: PlanExecutor | None = None,
) -> Coordinator:
    """A coordinator with the scenario's array, sizes of parcels, and motion, as it is to believe.

    `cells` are those of a real or served table, and None in a simulation. `main` is a program in
    Python, in place of the scenario's tasks, field or goals. `executor` makes its plans. Raises
    `InputError` for values that do not fit the firmware.
    """
    if main is not None:
        scenario = programmed(scenario)
    scenario = believed(scenario)
    refuse_unstoppable(scenario)
    # Cells are listed on a real or served table only; those of a simulation are virtual.
    asks_boards = cells is not None
    cells = cells or Cells()
    layout, parcels = layout_of(scenario, cells), parcels_of(scenario)
    stock, centres_m = in_stock(scenario), centres_of_mass_m(scenario)
    program: Program | ByCells
    goals = goals_of(scenario)
    if scenario.motion.field not in ("goal", "program"):
        program = _field_program(scenario)
    elif scenario.motion.control == "cells":
        _check_speed(scenario, scenario.motion.speed_m_s * _wheel_share(scenario))
        motion = CellsMotion(limits_of(scenario), scenario.motion.go_on)
        led = CellsProgram(layout, parcels, motion, centres_of_mass_m=centres_m)
        masses = masses_of(scenario)
        program = cells_program(
            scenario, parcels, masses, led, layout=layout, main=main, executor=executor
        )
    else:
        if goals is not None:
            droop = drive_of(scenario.cell).droop
            _check_speed(scenario, scenario.motion.speed_m_s * _wheel_share(scenario) / droop)
        traction, masses = traction_of(scenario, layout, cells), masses_of(scenario)
        program = table_program(scenario, parcels, masses, traction, main=main, executor=executor)
    coordinator = Coordinator(
        layout,
        program,
        # A parcel in stock is announced when it may come.
        parcels=tuple(parcel for parcel in parcels if parcel.name not in stock),
        expected=ExpectedCells(
            settings_of(scenario.cell), cells.settings, cells.serials, asks_boards
        ),
        timing=timing_of(scenario.wire),
        policy=policy_of(scenario.run),
        centres_of_mass_m=centres_m,
    )
    if isinstance(program, TableProgram):
        heaviest_kg = inf if scenario.stop is None else scenario.stop.mass_kg
        program.attend(coordinator.tracker, heaviest_kg)
    return coordinator


def policy_of(run: Run) -> Policy:
    """The reaction to cells that fall out of action."""
    return Policy(OnLostCell(run.on_lost_cell), run.pauses, run.pause_s, run.hold_s)


def refuse_unstoppable(scenario: Scenario) -> None:
    """Raises `InputError` for parcels that the table's emergency stop does not hold.

    A scenario that does not state the limits of its stop is not judged.
    """
    stop, motion = scenario.stop, scenario.motion
    if stop is None:
        return
    masses_kg = {f"parcel.{n}.mass_kg": each.mass_kg for n, each in enumerate(scenario.parcel)}
    masses_kg |= {f"task.{n}.mass_kg": each.mass_kg or 0.0 for n, each in enumerate(scenario.task)}
    for key, mass_kg in masses_kg.items():
        if mass_kg > stop.mass_kg:
            raise InputError(
                f"{key} is {mass_kg:g}, but the table's emergency stop holds {stop.mass_kg:g} kg "
                "at most (stop.mass_kg); leave that parcel out, or measure the limit of the stop "
                "and state it"
            )
    if motion.field in ("goal", "program"):
        _refuse_faster(stop, "motion.speed_m_s is", motion.speed_m_s)


def _refuse_faster(stop: Stop, what: str, speed_m_s: float) -> None:
    if speed_m_s > stop.speed_m_s:
        raise InputError(
            f"{what} {speed_m_s:.3g}, but the table's emergency stop holds parcels at "
            f"{stop.speed_m_s:g} m/s at most (stop.speed_m_s); go slower, as with --set "
            f"motion.speed_m_s={stop.speed_m_s:g}"
        )


def _check_speed(scenario: Scenario, fastest_m_s: float) -> None:
    """Raise `InputError` for a motion that may ask for references which the wire does not carry.

    A wheel under a parcel that moves and turns goes faster than its centre and its corners, which
    are within the speed together.
    """
    entry = pdo.TARGET_VELOCITY.entries[0]
    limit_m_s = entry.high / steps_per_unit(entry.unit)
    if fastest_m_s > limit_m_s:
        raise InputError(
            f"motion.speed_m_s is {scenario.motion.speed_m_s:g}: wheels would be set to "
            f"{fastest_m_s:.3g} m/s, but a setpoint on the wire is at most {limit_m_s:g} m/s"
        )


def _wheel_share(scenario: Scenario) -> float:
    """Speed of the fastest wheel for a parcel, over that of its centre and corners together.

    Wheels as far outside as `AHEAD_M` run for a parcel too: sqrt(1 + (r / reach)^2) at most.
    """
    reaches_m = [hypot(parcel.length_m, parcel.width_m) / 2 for parcel in scenario.parcel]
    shares = (hypot(1.0, 1.0 + AHEAD_M / reach_m) for reach_m in reaches_m)
    return max(shares, default=hypot(1.0, 1.0))


def layout_of(scenario: Scenario, cells: Cells | None = None) -> Layout:
    """The array as the host believes it to be: here, as the scenario has it."""
    array, cell = scenario.array, scenario.cell
    addresses = addresses_of(scenario, cells or Cells())
    return Layout(
        columns=array.columns,
        rows=array.rows,
        pitch_m=array.pitch_m,
        wheels=tuple(WheelPlace(wheel.direction_rad, wheel.offset_m) for wheel in cell.wheel),
        sensor_offsets_m=cell.sensor_offset_m,
        node_ids=addresses.node_ids,
        buses=addresses.buses,
    )


def settings_of(cell: Cell) -> tuple[Setting, ...]:
    """The settings that the host relies on; they override those saved in a cell.

    Raises `InputError`.
    """
    counts_per_m = (
        cell.encoder_counts_per_motor_rev * cell.gear_ratio / (2 * pi * cell.wheel_radius_m)
    )
    acceleration = observer_for(motor_of(cell)).acceleration_m_s2_per_v
    wanted = {
        indices.GAIN: ("cell.gain_vs_per_m", cell.gain_vs_per_m),
        indices.RESOLUTION: ("the encoder's counts per metre", int(counts_per_m)),
        indices.VOLTAGE_LIMIT: ("cell.supply_v", cell.supply_v),
        indices.ACCELERATION_PER_VOLT: ("the motor's acceleration per volt", acceleration),
    }
    axes = tuple(
        _setting(index + axis * indices.AXIS_OFFSET, *meaning)
        for axis in range(len(cell.wheel))
        for index, meaning in wanted.items()
    )
    undervoltage_v = min(UNDERVOLTAGE_V, cell.supply_v / 2)
    return (
        *axes,
        *_braking(cell),
        _setting(indices.UNDERVOLTAGE_LIMIT, "half of cell.supply_v", undervoltage_v),
    )


def _braking(cell: Cell) -> Iterator[Setting]:
    """A smaller braking gain than cells come with, where their motors need it."""
    motor = motor_of(cell)
    entry = ENTRIES[indices.BRAKING_GAIN, 0]
    if motor.mass_kg > 0.0:
        largest_vs_per_m = largest_gain(motor, observer_for(motor))
        if largest_vs_per_m < entry.default / steps_per_unit(entry.unit):
            for axis in range(len(cell.wheel)):
                index = indices.BRAKING_GAIN + axis * indices.AXIS_OFFSET
                yield _setting(index, "the largest gain", largest_vs_per_m)


def estimates_of(coordinator: Coordinator, scenario: Scenario) -> Floats:
    """Poses that the coordinator believes the parcels to have, shape (P, 3), NaN where unknown."""
    believed = (coordinator.estimate(parcel.name) for parcel in scenario.parcel)
    unknown = (np.nan, np.nan, np.nan)
    poses = [(one.x_m, one.y_m, one.yaw_rad) if one else unknown for one in believed]
    return np.array(poses, float).reshape(-1, 3)


def _setting(index: int, meaning: str, value: float) -> Setting:
    entry = ENTRIES[index, 0]
    number = round(value * steps_per_unit(entry.unit))
    try:
        pdo.check(entry, number)
    except OutOfRangeError as error:
        raise InputError(f"{meaning} does not fit the firmware: {error}") from None
    return Setting(index, 0, number)


def parcels_of(scenario: Scenario) -> tuple[Parcel, ...]:
    """The parcels as the host gets them: size, and where each was put.

    A parcel that lies elsewhere is found there. Its given place counts if something looks alike.
    """
    return tuple(
        Parcel(
            name=parcel.name,
            length_m=parcel.length_m,
            width_m=parcel.width_m,
            near_m=(parcel.x_m, parcel.y_m),
            yaw_hint_rad=parcel.yaw_rad,
            shape=parcel.shape,
            corners_m=parcel.corners_m,
            spread_m=parcel.size_spread_m,
        )
        for parcel in scenario.parcel
    )


def goals_of(scenario: Scenario) -> dict[str, GoalPose] | None:
    """The goals of a scenario's parcels, by name; None for a scenario of another motion."""
    if scenario.motion.field != "goal":
        return None
    goals = ((parcel.name, goal_of(parcel)) for parcel in scenario.parcel)
    return {name: goal for name, goal in goals if goal is not None}


def _field_program(scenario: Scenario) -> FieldProgram:
    field_m_s = references_m_s(scenario)
    _check_speed(scenario, float(abs(field_m_s).max()))
    if scenario.stop is not None:
        # The wheels of a cell push along directions of their own, and a parcel by all of them.
        along_m_s = field_m_s.reshape(-1, len(scenario.cell.wheel))
        fastest_m_s = float(np.linalg.norm(along_m_s, axis=1).max())
        fastest_m_s *= drive_of(scenario.cell).droop
        _refuse_faster(scenario.stop, "motion.field moves parcels at [m/s]", fastest_m_s)
    return FieldProgram(field_m_s)


def limits_of(scenario: Scenario) -> Limits:
    """How fast cells that steer may move parcels."""
    return Limits(
        speed_m_s=scenario.motion.speed_m_s,
        friction=scenario.cell.friction,
        gravity_m_s2=scenario.run.gravity_m_s2,
    )


def traction_of(scenario: Scenario, layout: Layout, cells: Cells | None = None) -> Traction:
    """The limits of the wheels by friction and motors, as they are believed."""
    entry = pdo.TARGET_VELOCITY.entries[0]
    drives = wheel_drives_of(
        scenario.cell,
        gains_vs_per_m(scenario, cells or Cells()),
        entry.high / steps_per_unit(entry.unit),
    )
    return Traction(
        layout,
        drives,
        friction=scenario.cell.friction,
        speed_m_s=scenario.motion.speed_m_s,
        gravity_m_s2=scenario.run.gravity_m_s2,
    )


def centres_of_mass_m(scenario: Scenario) -> dict[str, tuple[float, float]]:
    """Where each parcel's centre of mass is, in its own frame, as it is believed [m]."""
    return {parcel.name: parcel.centre_of_mass_m for parcel in scenario.parcel}


def masses_of(scenario: Scenario) -> dict[str, Mass]:
    """The parcels' masses, as they are believed."""
    records, _ = parcel_records(scenario.parcel)
    return {
        parcel.name: Mass(parcel.mass_kg, float(record.inertia_kg_m2), parcel.centre_of_mass_m)
        for parcel, record in zip(scenario.parcel, records, strict=True)
    }
