"""Puts host and simulator together: a scenario is run in its fidelity."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from mdms_host.command.exits import CommandError, Exit
from mdms_host.command.inputs import refusing_bad_scenarios

if TYPE_CHECKING:
    from mdms_sim.record import Floats, Record
    from mdms_sim.scenario import Scenario
    from mdms_sim.simulation import BusFigures


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
    from mdms_sim.slip import slip_m_s

    with refusing_bad_scenarios():
        if scenario.run.fidelity == "firmware":
            finished = _run_firmware(scenario, nodes, progress, bus_log)
        else:
            finished = _run_model(scenario)
    if finished.record.slip_m_s is None:
        finished.record.slip_m_s = slip_m_s(scenario, finished.record)
    return finished


def _run_model(scenario: "Scenario") -> Finished:
    """The paper's model, without cells and bus."""
    from mdms_host.command.references import references_m_s

    solve, reference_m_s = _solver(scenario.run.fidelity), references_m_s(scenario)
    start_s = perf_counter()
    record = solve(scenario, reference_m_s)
    return Finished(record, perf_counter() - start_s)


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
    from mdms_host.command.coordination import coordinator_of, estimates_of
    from mdms_sim.nodes.bank import MicropythonMissing, NodeError
    from mdms_sim.record import Event
    from mdms_sim.simulation import simulate

    coordinator = coordinator_of(scenario)
    start_s = perf_counter()
    try:
        outcome = simulate(
            scenario,
            [coordinator],
            nodes,
            bus_log=bus_log,
            estimates=lambda: estimates_of(coordinator, scenario),
            progress=progress,
        )
    except NodeError as error:
        missing = isinstance(error, MicropythonMissing)
        raise CommandError(str(error), Exit.NO_DEVICE if missing else Exit.NODE_FAULT) from None
    wall_s = perf_counter() - start_s
    told = [Event(time_s, "coordinator", text) for time_s, text in coordinator.events]
    outcome.record.events = sorted(outcome.record.events + told, key=lambda event: event.time_s)
    return Finished(outcome.record, wall_s, nodes, outcome.bus, coordinator.fault)
