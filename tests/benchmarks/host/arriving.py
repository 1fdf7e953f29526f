"""Parcels of three kinds between random poses on 6 x 3 cells: arrivals and beliefs.

Two boxes and a disc get seeded start and goal poses on the cells of `array18`, no nearer to tipping
than a run allows, and are carried as fast as friction lets them. `python -m tests.benchmarks
arriving` prints, each with the lower end of a one-sided 95 % confidence interval (Clopper and
Pearson),

- how many end within 3 mm and 1 degree of their goals in truth, at rest, and upright;
- the same under stress: 1 % of sensor readings wrong, lengths and widths told 2 mm wrong, friction
  from 0.1 to 0.6 where 0.3 is told, wheels 1 % larger or smaller than told;
- the same with one random cell dead from a random instant on, the run going on without it;
- the same cases in the open-loop inward field about the goal, as a comparison;

and the 95th percentiles of how far the belief is off after three edges, moving (faster than 5 mm/s)
and at rest, with a mean time from leaving to arriving.

`ARRIVING_CASES` in the environment is how many cases each has (200), `ARRIVING_SEED` the first seed
(1), `ARRIVING_KINDS` which of nominal, stress, dead and field (all). A case takes a second or two.
"""

import os
from contextlib import closing
from dataclasses import dataclass, field
from math import degrees, hypot, inf, pi, radians
from random import Random
from typing import Any

import numpy as np
from tests.benchmarks.cells.neighbours import CONFIDENCE, at_least

from mdms_array.host import coordinator_of
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.estimation.tracker import Tracker
from mdms_host.motion.footholds import MARGIN_M
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.safe_goals import SupportedParcel, least_footing
from mdms_model.array import build_wheels
from mdms_model.outline import outline_of
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

WITHIN_M, WITHIN_RAD = 0.003, radians(1.0)
LIMIT_S, FIELD_S = 12.0, 8.0
REST_S = 0.5
STEP_S = 0.01
EVERY_STEPS = 5
EDGES = 3
MOVING_M_S, MOVING_RAD_S = 0.005, 0.02
CELLS = 18
#: Length, width, mass; a disc has but one.
PARCELS = (
    ("rectangle", 0.36, 0.30, 2.0),
    ("rectangle", 0.28, 0.22, 1.2),
    ("disc", 0.30, 0.30, 1.4),
)
KINDS = ("nominal", "stress", "dead", "field")
Row = dict[str, Any]


@dataclass
class Case:
    """How a run ended, and how far the belief was off: (distance [m], turn [rad]) each time."""

    arrived: bool = False
    reason: str = ""
    time_s: float = inf
    moving: list[tuple[float, float]] = field(default_factory=list)
    resting: list[tuple[float, float]] = field(default_factory=list)


def keys_of(seed: int) -> list[str]:
    """A parcel, its start and its goal, drawn until nothing on the way is near to tipping."""
    random = Random(f"arriving/{seed}")
    shape, length_m, width_m, mass_kg = PARCELS[seed % len(PARCELS)]
    keys = [
        f"run.seed={seed}",
        f"parcel.0.shape='{shape}'",
        f"parcel.0.length_m={length_m}",
        f"parcel.0.width_m={width_m}",
        f"parcel.0.mass_kg={mass_kg}",
        "motion.speed_m_s=0.6",
    ]
    scenario = load_scenario("array18", keys + _placed(shape, (0.0,) * 3, (0.0,) * 3))
    wheel_m = build_wheels(scenario).position_m
    load = SupportedParcel(outline_of(scenario.parcel[0]), (0.0, 0.0))
    while True:
        start, goal = _drawn(random), _drawn(random)
        if hypot(start[0] - goal[0], start[1] - goal[1]) < 0.05:
            continue
        target = GoalPose(goal[0], goal[1], None if shape == "disc" else goal[2])
        if least_footing(wheel_m, load, np.array(start), target).margin_m >= MARGIN_M:
            return keys + _placed(shape, start, goal)


def _drawn(random: Random) -> tuple[float, float, float]:
    return random.uniform(-0.26, 0.26), random.uniform(-0.09, 0.09), random.uniform(-1.5, 1.5)


def _placed(
    shape: str, start: tuple[float, float, float], goal: tuple[float, float, float]
) -> list[str]:
    ends = {"parcel.0": start, "parcel.0.goal": (*goal[:2], 0.0 if shape == "disc" else goal[2])}
    return [
        f"{end}.{key}={value}"
        for end, pose in ends.items()
        for key, value in zip(("x_m", "y_m", "yaw_rad"), pose, strict=True)
    ]


def scenario_of(kind: str, seed: int) -> Scenario:
    """The scenario of a kind and a seed."""
    random = Random(f"arriving/{kind}/{seed}")
    keys = keys_of(seed)
    if kind == "stress":
        shape, *sides_m, _ = PARCELS[seed % len(PARCELS)]
        told_m = [side_m + random.choice((-0.002, 0.002)) for side_m in sides_m]
        if shape == "disc":
            told_m[1] = told_m[0]
        keys += [
            "cell.sensor_noise=0.01",
            f"belief.box.length_m={told_m[0]}",
            f"belief.box.width_m={told_m[1]}",
            f"cell.friction={random.uniform(0.1, 0.6)}",
            "belief.friction=0.3",
            f"belief.wheel_radius_m={0.0254 * random.choice((0.99, 1.01))}",
        ]
    elif kind == "dead":
        fault = f"kind='off', cells=[{random.randint(1, CELLS)}]"
        start_s = random.uniform(0.5, 1.5)
        keys += ["run.on_lost_cell='go_on'", f"fault=[{{{fault}, start_s={start_s:.3f}}}]"]
    elif kind == "field":
        goal = load_scenario("array18", keys).parcel[0].goal
        assert goal is not None
        keys += [
            "motion.field='inward'",
            f"motion.centre_m=[{goal.x_m}, {goal.y_m}]",
            "motion.speed_m_s=0.0635",
        ]
    return load_scenario("array18", keys)


class _Edges:
    """Counts the edges that a tracker has got since it found its parcel."""

    def __init__(self, tracker: Tracker) -> None:
        self.count = 0
        self._tracker = tracker
        self._bits: dict[int, int] = {}
        self._on_presence = tracker.on_presence
        vars(tracker).update(on_presence=self._presence)

    def _presence(self, now_s: float, cell: int, bits: int) -> None:
        if cell in self._bits and self._tracker.poses(now_s):
            self.count += (self._bits[cell] ^ bits).bit_count()
        self._bits[cell] = bits
        self._on_presence(now_s, cell, bits)


def case(kind: str, seed: int) -> Case:
    """Run until the parcel rests at its goal, the run has ended, or the time is over."""
    scenario = scenario_of(kind, seed)
    coordinator, result = coordinator_of(scenario), Case()
    edges = _Edges(coordinator.tracker)
    limit_s = FIELD_S if kind == "field" else LIMIT_S
    began_s: float | None = None
    rested_s = 0.0
    with closing(PythonBank(range(1, CELLS + 1))) as bank:
        simulation = Simulation(scenario, bank, [coordinator], recording=None)
        for step in range(1, round(limit_s / STEP_S) + 1):
            now_s = STEP_S * step
            simulation.run_until(now_s)
            vx_m_s, vy_m_s, rate_rad_s = simulation.world.twist[0].tolist()
            moving = hypot(vx_m_s, vy_m_s) > MOVING_M_S or abs(rate_rad_s) > MOVING_RAD_S
            if moving and began_s is None:
                began_s = now_s
            if step % EVERY_STEPS == 0 and edges.count >= EDGES and kind != "field":
                _compare(coordinator, simulation, result.moving if moving else result.resting)
            rested_s = rested_s + STEP_S if coordinator.finished else 0.0
            if rested_s > REST_S or coordinator.stopped or simulation.tipped:
                break
        pose = simulation.world.pose[0]
    result.time_s = now_s - rested_s - (began_s or 0.0)
    _judge(result, scenario, pose, simulation.tipped, coordinator)
    return result


def _compare(
    coordinator: Coordinator, simulation: Simulation, into: list[tuple[float, float]]
) -> None:
    """Note how far the belief is off; a box looks the same after half a turn, a disc always."""
    pose = coordinator.tracker.poses(simulation.kernel.now_ns * 1e-9).get("box")
    if pose is None:
        return
    off = pose - simulation.world.pose[0]
    disc = simulation.world.scenario.parcel[0].shape == "disc"
    turn_rad = 0.0 if disc else (off[2] + pi / 2) % pi - pi / 2
    into.append((hypot(off[0], off[1]), abs(turn_rad)))


def _judge(
    result: Case, scenario: Scenario, pose: np.ndarray, tipped: bool, coordinator: Coordinator
) -> None:
    goal = scenario.parcel[0].goal
    assert goal is not None
    off_m = hypot(pose[0] - goal.x_m, pose[1] - goal.y_m)
    turn_rad = (pose[2] - goal.yaw_rad + pi / 2) % pi - pi / 2
    if scenario.parcel[0].shape == "disc":
        turn_rad = 0.0
    result.arrived = off_m <= WITHIN_M and abs(turn_rad) <= WITHIN_RAD and not tipped
    away = f"{1e3 * off_m:.1f} mm and {degrees(turn_rad):.1f} degrees away"
    why = "tipped" if tipped else coordinator.fault or coordinator.lost or coordinator.stuck
    result.reason = f"{away} ({why})" if why else away


def run_kind(kind: str, seeds: range) -> list[Row]:
    """Rows: the share that arrives, and the error of the belief."""
    cases = {seed: case(kind, seed) for seed in seeds}
    missed = {seed: one.reason for seed, one in cases.items() if not one.arrived}
    well = len(cases) - len(missed)
    times_s = [one.time_s for one in cases.values() if one.arrived]
    rows: list[Row] = [
        {
            "name": f"{kind}: within 3 mm and 1 degree",
            "ours": 100 * well / len(cases),
            "peer": None,
            "ratio": None,
            "unit": f"% of {len(cases)}",
            "bound": 100 * at_least(well, len(cases)),
            "mean_s": float(np.mean(times_s)) if times_s else None,
            "missed": "; ".join(f"{seed}: {reason}" for seed, reason in missed.items()) or None,
        }
    ]
    for state in ("moving", "resting"):
        off = np.array([each for one in cases.values() for each in getattr(one, state)])
        if len(off):
            rows.append(
                {
                    "name": f"{kind}: belief off, {state}, 95th percentile",
                    "ours": 1e3 * float(np.percentile(off[:, 0], 95)),
                    "peer": None,
                    "ratio": None,
                    "unit": f"mm of {len(off)}",
                    "yaw_deg": degrees(float(np.percentile(off[:, 1], 95))),
                }
            )
    return rows


def run() -> list[Row]:
    """All kinds."""
    cases = int(os.environ.get("ARRIVING_CASES", "200"))
    first = int(os.environ.get("ARRIVING_SEED", "1"))
    kinds = os.environ.get("ARRIVING_KINDS", " ".join(KINDS)).split()
    print(
        f"ARRIVING_CASES={cases} ARRIVING_SEED={first} python -m tests.benchmarks arriving: "
        f"seeds {first} to {first + cases - 1}; bounds one-sided, {CONFIDENCE:.0%}",
        flush=True,
    )
    rows: list[Row] = []
    for kind in kinds:
        rows += run_kind(kind, range(first, first + cases))
    return rows
