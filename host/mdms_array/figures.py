"""The outcome of a run: its one status and reason, and its figures, for JSON and for people."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from math import degrees, hypot, pi
from typing import TYPE_CHECKING, Any

import numpy as np

from mdms_array.host import break_off, has_failed, late_text
from mdms_array.run import ERRORS, Incident, ParcelRun, Run
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.outcome import REACHED_M, REACHED_RAD, GoalOutcome, missed_text, outcome_of
from mdms_model.arrays import Floats
from mdms_model.run.derived import lifted_s, slip_m_s
from mdms_model.run.record import Contact, Event, Record, exit_of, is_wrong
from mdms_model.scenario.scenario import Scenario

if TYPE_CHECKING:
    from mdms_sim.referee.rules import Violation
    from mdms_sim.simulation import BusFigures

POSE = ("x_m", "y_m", "yaw_rad")
TWIST = ("vx_m_s", "vy_m_s", "yaw_rate_rad_s")
#: A parcel is at rest when all through the last while it was slower than this.
REST_WHILE_S = 0.5
REST_SPEED_M_S = 1e-3
REST_YAW_RATE_RAD_S = 5e-3
#: A contact slips from this speed of the wheel's surface over the parcel on.
SLIPPING_M_S = 5e-3
#: Fewer parcels give no rate.
RATED = 10
#: Compiling that takes less is not reported [s].
REPORTED_S = 0.5


def simulated_run(
    scenario: Scenario,
    record: Record,
    coordinator: Coordinator | None = None,
    *,
    nodes: str | None = None,
    bus: "BusFigures | None" = None,
    violations: "Sequence[Violation]" = (),
    fault: str | None = None,
    wall_s: float = 0.0,
    compile_s: float = 0.0,
    by_hand: bool = False,
) -> Run:
    """The outcome of a simulation, judged by the truth; `fault` has ended it, if anything did.

    `wall_s` leaves out `compile_s`, which passes once per installation. A table `by_hand` has no
    program that could be late.
    """
    if record.slip_m_s is None:
        record.slip_m_s = slip_m_s(scenario, record)
    goals = {} if coordinator is None else dict(coordinator.goals)
    outcomes = _true_outcomes(scenario, record, goals)
    late = coordinator is not None and not by_hand and not coordinator.finished
    if coordinator is not None:
        fault = fault or coordinator.fault
    # Whoever knows the truth need not doubt.
    status, reason = _status(record.events, coordinator, fault, outcomes, late=late, unsure={})
    duration_s, wall_s = float(record.time_s[-1] - record.time_s[0]), max(wall_s, 1e-6)
    figures: dict[str, Any] = {
        "title": scenario.title,
        "fidelity": scenario.run.fidelity,
        "nodes": nodes,
        "seed": scenario.run.seed,
        "duration_s": duration_s,
        "wall_s": wall_s,
        "compile_s": compile_s,
        "real_time_factor": duration_s / wall_s,
        "status": status,
        "reason": reason,
        "parcels": _parcels(scenario, record),
        "goals": [asdict(outcome) for outcome in outcomes],
        "fault": _tip(record.events) or _fault(coordinator, fault),
        "slipping_share": slipping_share(record),
    }
    if scenario.stream:
        figures["stream"] = stream_figures(scenario, record)
    if bus is not None:
        figures |= {"bus": asdict(bus), **_cells_lost(coordinator)}
        figures["violations"] = [asdict(violation) for violation in violations]
    return _run(
        scenario,
        (status, reason),
        record,
        figures,
        coordinator,
        outcomes=outcomes,
        violations=violations,
        bus=bus,
    )


def believed_run(
    scenario: Scenario,
    record: Record,
    coordinator: Coordinator,
    *,
    fault: str | None,
    late: bool = False,
    interrupted: bool = False,
) -> Run:
    """The outcome of a run on a real or served table, as it is believed: nobody knows the truth.

    `fault` is what ended it, if anything did; `late` is whether its program was to end and has not,
    and `interrupted` whether a person has ended it.
    """
    outcomes = _believed_outcomes(scenario, coordinator)
    judged, unsure = _judged(outcomes, coordinator, late=late), coordinator.unsure
    status, reason = _status(record.events, coordinator, fault, judged, late=late, unsure=unsure)
    if interrupted and status == "time limit":
        status, reason = "stopped", "stopped by a person"
    figures: dict[str, Any] = {
        "title": scenario.title,
        "status": status,
        "reason": reason,
        "fault": _fault(coordinator, fault),
        **_cells_lost(coordinator),
        "parcels": _parcels(scenario, record),
        "goals": [asdict(outcome) for outcome in outcomes],
    }
    return _run(scenario, (status, reason), record, figures, coordinator, outcomes=outcomes)


def broken_off(run: Run, coordinator: Coordinator) -> Run:
    """Break off what is left of the program. An error of that makes the returned run failed."""
    failure = break_off(coordinator)
    if failure is None:
        return run
    status = "failed" if run.status in ("reached", "time limit") else run.status
    reason = failure if run.endless or not run.reason else f"{run.reason}; {failure}"
    figures = {**run.figures, "status": status, "reason": reason, "fault": reason}
    return replace(run, status=status, reason=reason, figures=figures, endless=False)


def _judged(
    outcomes: Iterable[GoalOutcome], coordinator: Coordinator, *, late: bool
) -> list[GoalOutcome]:
    """The outcomes that count: of a finished program those of parcels that have not arrived.

    One that has arrived may roll on a little off the wheels. A program may end without waiting for
    a parcel.
    """
    there = coordinator.arrived if coordinator.finished and not late else ()
    return [each for each in outcomes if each.parcel not in there]


def raise_for_end(scenario: Scenario, coordinator: Coordinator, *, late: bool) -> None:
    """Raise the `RunError` of a run on a table that nobody has recorded, unless it ended well.

    `late` is whether its program was to end and has not.
    """
    judged = _judged(_believed_outcomes(scenario, coordinator), coordinator, late=late)
    fault, unsure = coordinator.fault, coordinator.unsure
    status, reason = _status((), coordinator, fault, judged, late=late, unsure=unsure)
    if status in ERRORS and not (status == "time limit" and coordinator.endless):
        raise ERRORS[status](reason)


def _run(
    scenario: Scenario,
    verdict: tuple[str, str],
    record: Record,
    figures: dict[str, Any],
    coordinator: Coordinator | None,
    *,
    outcomes: Iterable[GoalOutcome],
    violations: "Sequence[Violation]" = (),
    bus: "BusFigures | None" = None,
) -> Run:
    troubles = () if coordinator is None else tuple(coordinator.troubles)
    return Run(
        scenario,
        *verdict,
        record,
        figures,
        _parcel_runs(scenario, record, coordinator, {each.parcel: each for each in outcomes}),
        incidents=[Incident(time_s, text) for time_s, text in troubles],
        lost_cells=() if coordinator is None else tuple(sorted(coordinator.lost_cells)),
        pauses=0 if coordinator is None else coordinator.pauses,
        violations=violations,
        bus=bus,
        endless=coordinator is not None and coordinator.endless,
    )


def _status(
    events: Sequence[Event],
    coordinator: Coordinator | None,
    fault: str | None,
    outcomes: Iterable[GoalOutcome],
    *,
    late: bool,
    unsure: Mapping[str, str],
) -> tuple[str, str]:
    """How a run has ended, and why if not as asked: the first of these that has a reason.

    The fate of a parcel comes first, then the cells, then the program. `unsure` has the parcels
    that may be beside their goals, where nobody knows the truth.
    """
    wrong, missed = _wrong(events), missed_text(outcomes, unsure)
    reasons: list[tuple[str, str | None]] = [("lost", _tip(events))]
    if coordinator is not None:
        stuck, endless = coordinator.stuck, coordinator.endless
        failed = has_failed(coordinator)
        reasons += [
            ("fault", fault),
            ("failed", stuck if failed else None),
            ("lost", coordinator.lost),
            ("failed", wrong),
            # How far it is from its goal says more than that it cannot go on.
            ("stopped", "; ".join(filter(None, (missed, stuck))) if stuck else None),
            ("time limit", missed),
            ("time limit", late_text(coordinator) if late and not endless else None),
            ("time limit", "the job has no end of its own" if endless else None),
        ]
    else:
        reasons += [("fault", fault), ("failed", wrong)]
    return next(((status, reason) for status, reason in reasons if reason), ("reached", ""))


def _tip(events: Sequence[Event]) -> str | None:
    """Which parcel has tipped first; None where none has."""
    tips = (event for event in events if event.kind == "tip")
    return next((f"{tip.parcel} tips at {tip.time_s:.3f} s: {tip.detail}" for tip in tips), None)


def _wrong(events: Sequence[Event]) -> str | None:
    """Which parcel has left by a wrong exit first; None where none has."""
    wrong = [event for event in events if event.kind == "exit" and is_wrong(event)]
    more = f", and {len(wrong) - 1} more after it" if len(wrong) > 1 else ""
    return f"{wrong[0].parcel} {wrong[0].detail}{more}" if wrong else None


def _fault(coordinator: Coordinator | None, fault: str | None) -> str | None:
    """Why the run has failed but for its time limit: cells, a parcel lost or stuck."""
    return fault if coordinator is None else fault or coordinator.lost or coordinator.stuck


def _cells_lost(coordinator: Coordinator | None) -> dict[str, Any]:
    if coordinator is None:
        return {"lost_cells": [], "pauses": 0}
    return {"lost_cells": sorted(coordinator.lost_cells), "pauses": coordinator.pauses}


def _parcel_runs(
    scenario: Scenario,
    record: Record,
    coordinator: Coordinator | None,
    outcomes: Mapping[str, GoalOutcome],
) -> dict[str, ParcelRun]:
    """The part of a record that is about each parcel, in the order of its arrays."""
    goals = {} if coordinator is None else coordinator.goals
    unknown = np.full_like(record.pose, np.nan)
    believed = unknown if record.estimate is None else record.estimate
    true = unknown if record.is_belief else record.pose
    return {
        parcel.name: ParcelRun(
            parcel.name,
            record.time_s,
            true[:, number],
            believed[:, number],
            _goal(goals.get(parcel.name)),
            outcomes.get(parcel.name),
        )
        for number, parcel in enumerate(scenario.parcel)
    }


def _goal(goal: GoalPose | None) -> tuple[float, float, float | None] | None:
    return None if goal is None else (goal.x_m, goal.y_m, goal.yaw_rad)


def stream_figures(scenario: Scenario, record: Record) -> dict[str, Any]:
    """Parcels that have come and left in truth, by exit, and whether any touched another."""
    left = [event for event in record.events if event.kind == "exit"]
    by_exit = dict.fromkeys((each.name for each in scenario.exit), 0)
    for event in left:
        by_exit[exit_of(event)] += 1
    begins_s = min(stream.start_s for stream in scenario.stream)
    lasts_s = max(0.0, float(record.time_s[-1]) - begins_s)
    return {
        "came": sum(event.kind == "arrival" for event in record.events),
        "left": len(left),
        "by_exit": by_exit,
        "wrong": sum(map(is_wrong, left)),
        "touches": sum(event.kind == "touch" for event in record.events),
        "lasts_s": lasts_s,
        "parcels_per_hour": 3600.0 * len(left) / max(lasts_s, 1e-9),
    }


def _true_outcomes(
    scenario: Scenario, record: Record, goals: Mapping[str, GoalPose]
) -> list[GoalOutcome]:
    """How far from its goal each parcel that was steered to one ends in truth."""
    outcomes = []
    for number, parcel in enumerate(scenario.parcel):
        goal = goals.get(parcel.name)
        if goal is not None:
            pose = record.pose[-1, number]
            is_on_table = np.isfinite(pose).all() and lifted_s(record, parcel.name) is None
            there = _pose(pose) if is_on_table else None
            outcomes.append(outcome_of(parcel.name, goal, there, _there_s(record, number, goal)))
    return outcomes


def _believed_outcomes(scenario: Scenario, coordinator: Coordinator) -> list[GoalOutcome]:
    """How far from its goal each parcel that was steered to one is believed to have ended."""
    goals = coordinator.goals
    return [
        _believed_outcome(coordinator, parcel.name, goals[parcel.name])
        for parcel in scenario.parcel
        if parcel.name in goals
    ]


def _believed_outcome(coordinator: Coordinator, name: str, goal: GoalPose) -> GoalOutcome:
    """How far from its goal a parcel is believed to have ended."""
    believed = coordinator.estimate(name)
    pose = None if believed is None else (believed.x_m, believed.y_m, believed.yaw_rad)
    outcome = outcome_of(name, goal, pose, coordinator.arrived_s.get(name))
    return replace(outcome, reached=outcome.reached and name not in coordinator.unsure)


def slipping_share(record: Record) -> float:
    """Share of wheel contacts in motion, sample by sample, that slipped; see `SLIPPING_M_S`.

    0 where nothing moved. Slower slip is the creep of wheels that are near to what friction gives.
    """
    slip_m_s = np.zeros(1) if record.slip_m_s is None else record.slip_m_s
    carried_m_s = record.speed_m_s - slip_m_s
    moving = np.maximum(abs(record.speed_m_s), abs(carried_m_s)) > REST_SPEED_M_S
    moving &= record.contact != Contact.NONE
    slipping = moving & (abs(slip_m_s) > SLIPPING_M_S)
    return float(slipping.sum() / max(moving.sum(), 1))


def _there_s(record: Record, number: int, goal: GoalPose) -> float | None:
    """Since when the parcel has been at its goal [s]; None if it is not there at the end."""
    x_m, y_m, yaw_rad = record.pose[:, number].T
    # A parcel without a place is not there.
    away = ~(np.hypot(x_m - goal.x_m, y_m - goal.y_m) <= REACHED_M)
    if goal.yaw_rad is not None:
        away |= ~(abs((yaw_rad - goal.yaw_rad + pi) % (2 * pi) - pi) <= REACHED_RAD)
    if away[-1]:
        return None
    outside = np.flatnonzero(away)
    return float(record.time_s[outside[-1] + 1 if len(outside) else 0])


def _pose(values: Floats) -> tuple[float, float, float]:
    x_m, y_m, yaw_rad = values.tolist()
    return x_m, y_m, yaw_rad


def _parcels(scenario: Scenario, record: Record) -> list[dict[str, Any]]:
    """True and believed place of each parcel in the end; a parcel that is away has none."""
    parcels = (
        {"name": parcel.name}
        | _lifted(record, parcel.name, _truth(record, number))
        | _belief(record, number)
        for number, parcel in enumerate(scenario.parcel)
    )
    return [
        parcel
        for parcel in parcels
        if "x_m" in parcel or ("estimate" in parcel and record.is_belief)
    ]


def _truth(record: Record, number: int) -> dict[str, Any]:
    if not len(record.time_s) or not np.isfinite(record.pose[-1, number]).all():
        return {}
    named = _named(POSE, record.pose[-1, number]) | _named(TWIST, record.twist[-1, number])
    return named | {"at_rest": _at_rest(record, number)}


def _lifted(record: Record, name: str, truth: dict[str, Any]) -> dict[str, Any]:
    """The truth about a parcel at the end; a lifted one does not rest."""
    if truth and lifted_s(record, name) is not None:
        return truth | {"at_rest": False, "lifted": True}
    return truth


def _belief(record: Record, number: int) -> dict[str, Any]:
    if record.estimate is None or not np.isfinite(record.estimate[-1, number]).all():
        return {}
    return {"estimate": _named(POSE, record.estimate[-1, number])}


def _named(names: tuple[str, ...], values: Floats) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))


def _at_rest(record: Record, number: int) -> bool:
    """Whether the parcel stood still over the end of the run, not only at its last instant."""
    lately = record.time_s >= record.time_s[-1] - REST_WHILE_S
    vx_m_s, vy_m_s, yaw_rate_rad_s = record.twist[lately, number].T
    slow = np.hypot(vx_m_s, vy_m_s) < REST_SPEED_M_S
    return bool(np.all(slow & (abs(yaw_rate_rad_s) < REST_YAW_RATE_RAD_S)))


def report(figures: Mapping[str, Any]) -> list[str]:
    """The figures as lines for people."""
    nodes = f" on {figures['nodes']} nodes" if figures["nodes"] else ""
    lines = [
        figures["title"],
        f"  {figures['fidelity']}{nodes}, seed {figures['seed']}: {figures['duration_s']:g} s "
        f"in {figures['wall_s']:.3g} s, {figures['real_time_factor']:,.3g} times real time",
    ]
    if figures["compile_s"] >= REPORTED_S:
        lines.append(f"  after {figures['compile_s']:.1f} s of compiling")
    lines += [f"  {_sentence(parcel)}" for parcel in figures["parcels"]]
    if "stream" in figures:
        lines.append(f"  {_streamed(figures['stream'])}")
    if "bus" in figures:
        bus = figures["bus"]
        lines.append(
            f"  bus: {bus['frames']:,} frames, {100 * bus['load']:.0f} % load, "
            f"{bus['errors']} errors, log {bus['log_sha256'][:12]}"
        )
    return lines


def _streamed(stream: dict[str, Any]) -> str:
    exits = ", ".join(f"{count} by {name}" for name, count in stream["by_exit"].items())
    enough = stream["left"] >= RATED
    rate = f"{stream['parcels_per_hour']:,.0f} an hour" if enough else "too few for a rate"
    return (
        f"{stream['came']} parcels came, {stream['left']} left in {stream['lasts_s']:.1f} s "
        f"({exits}), {rate}; {stream['wrong']} by a wrong exit, {stream['touches']} touches"
    )


def _motion(parcel: dict[str, Any]) -> str:
    """The motion of a parcel at its last instant that has not been at rest for long."""
    speed_m_s = hypot(parcel["vx_m_s"], parcel["vy_m_s"])
    if speed_m_s >= REST_SPEED_M_S:
        return f"moving at {speed_m_s:.3f} m/s"
    if abs(parcel["yaw_rate_rad_s"]) >= REST_YAW_RATE_RAD_S:
        return f"turning at {degrees(parcel['yaw_rate_rad_s']):+z.1f} deg/s"
    return f"standing, for less than {REST_WHILE_S:g} s"


def _sentence(parcel: dict[str, Any]) -> str:
    if parcel.get("lifted"):
        return f"{parcel['name']}: lifted off the table"
    state = "at rest" if parcel["at_rest"] else _motion(parcel)
    return (
        f"{parcel['name']}: x {parcel['x_m']:+z.4f} m, y {parcel['y_m']:+z.4f} m, "
        f"yaw {degrees(parcel['yaw_rad']):+z.1f} deg, {state}"
    )
