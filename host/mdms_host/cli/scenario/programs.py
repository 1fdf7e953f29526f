"""From a scenario to the program that its tasks, or a file of Python, make of it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.goal import Limits
from mdms_host.motion.trajectory.mass import Mass
from mdms_host.motion.trajectory.traction import Traction
from mdms_host.programs.cells_program import CellsTableProgram
from mdms_host.programs.comings import Comings, Infeed
from mdms_host.programs.order import Gate
from mdms_host.programs.program import Main, Member, TableProgram
from mdms_host.programs.task_list import main_of
from mdms_host.programs.traffic.by_cells import CellsTraffic
from mdms_host.programs.traffic.by_host import TableTraffic
from mdms_host.programs.traffic.dispatch import KeptFree
from mdms_host.programs.traffic.planning import Desk, VirtualDesk
from mdms_host.programs.traffic.ride import Load
from mdms_host.routes.pace import TrapezoidPace
from mdms_host.routes.space.shape import Shape
from mdms_model.array import last_support_m
from mdms_model.arrays import Floats
from mdms_model.scenario.rules.every import check_rules
from mdms_model.scenario.rules.on_table import half_table_m
from mdms_model.scenario.scenario import Scenario, in_stock
from mdms_model.scenario.stream import Exit, Stream

#: Along which axis a side lies outward, and with which sign.
_OUTWARD = {"east": (0, 1), "west": (0, -1), "north": (1, 1), "south": (1, -1)}


def table_program(
    scenario: Scenario,
    parcels: tuple[Parcel, ...],
    masses: Mapping[str, Mass],
    traction: Traction,
    *,
    main: Main | None = None,
    desk: Desk | None = None,
) -> TableProgram:
    """The program of a scenario's tasks, or `main`, with all that it needs to be run."""
    named = {parcel.name: parcel for parcel in parcels}
    loads = _loads(named, masses)
    pace = TrapezoidPace(scenario.motion.speed_m_s, _acceleration_m_s2(traction, loads))
    traffic = TableTraffic(
        traction,
        pace,
        desk or VirtualDesk(),
        loads,
        kept_free=[
            _kept_free(number, stream, named) for number, stream in enumerate(scenario.stream)
        ],
    )
    infeeds = [_infeed(number, scenario, named) for number in range(len(scenario.stream))]
    gates = [gate_of(each, scenario, traction.layout) for each in scenario.exit]
    return TableProgram(
        main or main_of(scenario.task),
        half_table_m(scenario),
        _members(scenario),
        gates,
        traffic,
        comings=Comings(infeeds),
    )


def cells_program(
    scenario: Scenario,
    parcels: tuple[Parcel, ...],
    masses: Mapping[str, Mass],
    cells: CellsProgram,
    *,
    layout: Layout,
    limits: Limits,
    main: Main | None = None,
    desk: Desk | None = None,
) -> CellsTableProgram:
    """The same for cells that steer."""
    loads = _loads({parcel.name: parcel for parcel in parcels}, masses)
    traffic = CellsTraffic(layout, desk or VirtualDesk(), loads, cells, limits)
    main = main or main_of(scenario.task)
    return CellsTableProgram(main, half_table_m(scenario), _members(scenario), traffic, cells)


def _loads(named: Mapping[str, Parcel], masses: Mapping[str, Mass]) -> dict[str, Load]:
    return {name: Load(parcel.bottom, masses[name]) for name, parcel in named.items()}


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
    """What plans reckon with: the least that any parcel is sped up with along x or y."""
    agilities = [traction.agility(load.bottom, load.mass) for load in dict.fromkeys(loads.values())]
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
    return Infeed(f"infeed {number}", _place(stream), stock)


def _kept_free(number: int, stream: Stream, named: Mapping[str, Parcel]) -> KeptFree:
    bottoms = (named[name].bottom for name in stream.parcels)
    largest = max(bottoms, key=lambda bottom: bottom.reach_m)
    return KeptFree(f"infeed {number}", _place(stream), Shape(largest))


def _place(stream: Stream) -> Floats:
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


def waits_text(coordinator: Coordinator) -> str:
    """What a run's program waits for, as part of a message; nothing where it does not."""
    program = coordinator.program
    if not isinstance(program, TableProgram):
        return ""
    missing = [name for name in sorted(program.awaits) if coordinator.estimate(name) is None]
    if missing:
        return f": it has not begun, for {' and '.join(missing)} cannot be found on the table"
    places = program.waits_at
    return f": it waits in {' and '.join(places)}" if places else ""
