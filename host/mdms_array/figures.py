"""The figures of a run: the JSON of `simulate`, and the same for people."""

from dataclasses import asdict
from math import degrees, hypot, pi
from typing import Any

import numpy as np

from mdms_array.compiling import REPORTED_S
from mdms_array.run import Finished
from mdms_host.motion.goal import Goal
from mdms_host.motion.outcome import REACHED_M, REACHED_RAD, GoalOutcome, outcome_of
from mdms_model.arrays import Floats
from mdms_model.run.comings import exit_of, is_wrong
from mdms_model.run.record import Contact, Record
from mdms_model.scenario.scenario import Scenario

__all__ = ["figures_of", "report"]

POSE = ("x_m", "y_m", "yaw_rad")
TWIST = ("vx_m_s", "vy_m_s", "yaw_rate_rad_s")
#: A parcel is at rest when all through the last while it was slower than this.
REST_WHILE_S = 0.5
REST_SPEED_M_S = 1e-3
REST_YAW_RATE_RAD_S = 5e-3
#: A contact slips from this speed of the wheel's surface over the parcel on.
SLIPPING_M_S = 5e-3


def figures_of(scenario: Scenario, finished: Finished) -> dict[str, Any]:
    """What `mdms simulate --json` prints but the run folder's path."""
    record = finished.record
    duration_s = float(record.time_s[-1] - record.time_s[0])
    figures: dict[str, Any] = {
        "title": scenario.title,
        "fidelity": scenario.run.fidelity,
        "nodes": finished.nodes,
        "seed": scenario.run.seed,
        "duration_s": duration_s,
        "wall_s": finished.wall_s,
        "compile_s": finished.compile_s,
        "real_time_factor": duration_s / finished.wall_s,
        "parcels": [
            _parcel(scenario, record, number)
            for number in range(len(scenario.parcel))
            # One that is away is nowhere.
            if np.isfinite(record.pose[-1, number]).all()
        ],
        "goals": [asdict(outcome) for outcome in goals_of(scenario, finished)],
        "fault": fault_of(finished),
        "slipping_share": slipping_share(record),
    }
    if scenario.stream:
        figures["stream"] = stream_figures(scenario, record)
    if finished.bus is not None:
        figures["bus"] = asdict(finished.bus)
        figures["lost_cells"] = list(finished.lost_cells)
        figures["pauses"] = finished.pauses
        figures["violations"] = [asdict(violation) for violation in finished.violations]
    return figures


def stream_figures(scenario: Scenario, record: Record) -> dict[str, Any]:
    """What has come and left in truth, by which exit, and whether any touched another."""
    left = [event for event in record.events if event.kind == "exit"]
    by_exit = dict.fromkeys((each.name for each in scenario.exit), 0)
    for event in left:
        by_exit[exit_of(event)] += 1
    lasts_s = float(record.time_s[-1]) - min(stream.start_s for stream in scenario.stream)
    return {
        "came": sum(event.kind == "arrival" for event in record.events),
        "left": len(left),
        "by_exit": by_exit,
        "wrong": sum(map(is_wrong, left)),
        "touches": sum(event.kind == "touch" for event in record.events),
        "parcels_per_hour": 3600.0 * len(left) / max(lasts_s, 1e-9),
    }


def goals_of(scenario: Scenario, finished: Finished) -> list[GoalOutcome]:
    """How far from its goal each parcel that was steered to one ends in truth."""
    record, outcomes = finished.record, []
    for number, parcel in enumerate(scenario.parcel):
        goal = finished.goals.get(parcel.name)
        if goal is not None:
            pose = record.pose[-1, number]
            there = _pose(pose) if np.isfinite(pose).all() else None
            outcomes.append(outcome_of(parcel.name, goal, there, _there_s(record, number, goal)))
    return outcomes


def fault_of(finished: Finished) -> str | None:
    """Why the run has failed: a parcel that tips, a fault of the nodes, a parcel lost or stuck."""
    tips = (event for event in finished.record.events if event.kind == "tip")
    for tip in tips:
        return f"{tip.parcel} tips at {tip.time_s:.3f} s: {tip.detail}"
    return finished.fault or finished.lost or finished.stuck


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


def _there_s(record: Record, number: int, goal: Goal) -> float | None:
    """Since when the parcel has been at its goal [s]; None if it is not there at the end."""
    x_m, y_m, yaw_rad = record.pose[:, number].T
    # What is nowhere is not there.
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


def _parcel(scenario: Scenario, record: Record, number: int) -> dict[str, Any]:
    parcel: dict[str, Any] = {"name": scenario.parcel[number].name}
    parcel |= _named(POSE, record.pose[-1, number])
    parcel |= _named(TWIST, record.twist[-1, number])
    parcel["at_rest"] = _at_rest(record, number)
    if record.estimate is not None and np.isfinite(record.estimate[-1, number]).all():
        parcel["estimate"] = _named(POSE, record.estimate[-1, number])
    return parcel


def _named(names: tuple[str, ...], values: Floats) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))


def _at_rest(record: Record, number: int) -> bool:
    """Whether the parcel stood still over the end of the run, not only at its last instant."""
    lately = record.time_s >= record.time_s[-1] - REST_WHILE_S
    vx_m_s, vy_m_s, yaw_rate_rad_s = record.twist[lately, number].T
    slow = np.hypot(vx_m_s, vy_m_s) < REST_SPEED_M_S
    return bool(np.all(slow & (abs(yaw_rate_rad_s) < REST_YAW_RATE_RAD_S)))


def report(figures: dict[str, Any]) -> list[str]:
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
    return (
        f"{stream['came']} parcels came, {stream['left']} left ({exits}), "
        f"{stream['parcels_per_hour']:,.0f} an hour; {stream['wrong']} by a wrong exit, "
        f"{stream['touches']} touches"
    )


def _sentence(parcel: dict[str, Any]) -> str:
    speed_m_s = hypot(parcel["vx_m_s"], parcel["vy_m_s"])
    state = "at rest" if parcel["at_rest"] else f"moving at {speed_m_s:.3f} m/s"
    return (
        f"{parcel['name']}: x {parcel['x_m']:+.4f} m, y {parcel['y_m']:+.4f} m, "
        f"yaw {degrees(parcel['yaw_rad']):+.1f} deg, {state}"
    )
