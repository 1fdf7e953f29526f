"""Puts host and simulator together: a scenario is run in its fidelity."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.scenario.inputs import refusing_bad_scenarios
from mdms_host.cli.simulation.compiling import compiling_watched

if TYPE_CHECKING:
    from mdms_host.coordination.coordinator import Coordinator
    from mdms_model.arrays import Floats
    from mdms_model.run.record import Record
    from mdms_model.scenario.scenario import Scenario
    from mdms_sim.simulation import BusFigures


@dataclass(frozen=True, slots=True)
class Finished:
    """A run that has ended: what it recorded, how long it took, and what a coordinator met.

    `wall_s` leaves out `compile_s`, which passes once per installation.
    """

    record: "Record"
    nodes: str | None = None
    bus: "BusFigures | None" = None
    fault: str | None = None
    wall_s: float = 0.0
    compile_s: float = 0.0


def run_scenario(
    scenario: "Scenario",
    nodes: str = "cpython",
    progress: Callable[[float], None] | None = None,
    bus_log: Path | None = None,
) -> Finished:
    """Run a scenario in its fidelity. Raises `CommandError` for what it cannot be run with."""
    if scenario.run.fidelity == "firmware":
        return timed(scenario, lambda: _firmware(scenario, nodes, progress, bus_log))
    return timed(scenario, lambda: _model(scenario))


def timed(scenario: "Scenario", prepare: Callable[[], Callable[[], Finished]]) -> Finished:
    """Prepare a run, do it, and tell how long it took. Raises `CommandError` as the run does."""
    from mdms_host.clock import MonotonicClock
    from mdms_model.run.slip import slip_m_s

    with refusing_bad_scenarios(), compiling_watched() as compiled:
        work = prepare()
        before_s, clock = compiled.seconds, MonotonicClock()
        finished = work()
        wall_s = max(clock.now_s() - (compiled.seconds - before_s), 1e-6)
    if finished.record.slip_m_s is None:
        finished.record.slip_m_s = slip_m_s(scenario, finished.record)
    return replace(finished, wall_s=wall_s, compile_s=compiled.seconds)


def _model(scenario: "Scenario") -> Callable[[], Finished]:
    """The paper's model, without cells and bus, ready to run."""
    from mdms_host.cli.scenario.coordination import references_m_s

    solve, reference_m_s = _solver(scenario.run.fidelity), references_m_s(scenario)
    return lambda: Finished(solve(scenario, reference_m_s))


def _solver(fidelity: str) -> "Callable[[Scenario, Floats], Record]":
    if fidelity == "row":
        from mdms_sim.physics.row.solver import solve_row

        return solve_row
    from mdms_sim.physics.plane.ideal import solve_ideal

    return solve_ideal


def _firmware(
    scenario: "Scenario",
    nodes: str,
    progress: Callable[[float], None] | None,
    bus_log: Path | None,
) -> Callable[[], Finished]:
    """Cells, bus and coordinator, ready to run."""
    from mdms_host.cli.scenario.coordination import coordinator_of, estimates_of
    from mdms_sim.simulation import simulate

    coordinator = coordinator_of(scenario)

    def work() -> Finished:
        with telling_of_nodes():
            outcome = simulate(
                scenario,
                [coordinator],
                nodes,
                bus_log=bus_log,
                estimates=lambda: estimates_of(coordinator, scenario),
                progress=progress,
            )
        _tell_of_coordinator(outcome.record, coordinator)
        return Finished(outcome.record, nodes, outcome.bus, coordinator.fault)

    return work


@contextmanager
def telling_of_nodes() -> Iterator[None]:
    """Turns cells that cannot run into a `CommandError` (no MicroPython, or a node's fault)."""
    from mdms_sim.nodes.bank import MicropythonMissing, NodeError

    try:
        yield
    except MicropythonMissing as error:
        raise CommandError(str(error), Exit.NO_DEVICE) from None
    except NodeError as error:
        raise CommandError(str(error), Exit.NODE_FAULT) from None


def _tell_of_coordinator(record: "Record", coordinator: "Coordinator") -> None:
    """Put the coordinator's events among those of the physics, by time."""
    from mdms_model.run.record import Event

    told = [Event(time_s, "coordinator", text) for time_s, text in coordinator.events]
    record.events = sorted(record.events + told, key=lambda event: event.time_s)
