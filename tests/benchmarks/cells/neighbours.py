"""Cells that steer by themselves: how many boxes arrive, how well cells know where they are.

Boxes of three sizes get seeded start and goal poses on 6 x 3 cells, with motors and friction that
differ by up to 30 %. A box has arrived that ends within 5 mm and 2 degrees of its goal, and `bound`
is the lower end of a one-sided 95 % confidence interval of that share (Clopper and Pearson). A
belief is the estimate that a cell under the box sends at SYNC, after three changes of its sensors.
The host's own estimate in the same runs stands beside it, as long as there is a host. `MDMS_CASES`
is the number of cases of each kind (default 20), `MDMS_SEED` the first seed (default 1),
`MDMS_KIND` the beginning of the name of a kind (default: all); a case takes some 2 s. A box that
has not arrived stands where it was held, unless it is among those `fallen`.
"""

import os
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from math import comb, hypot, pi
from random import Random
from typing import Any

import numpy as np

from mdms_array.host import coordinator_of
from mdms_array.source import open_program
from mdms_host.coordination.coordinator import Coordinator
from mdms_model.buses import address_cells
from mdms_model.errors import InputError
from mdms_model.run.frame_readers import CellReports
from mdms_model.scenario.scenario import Scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours import frames as wire
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

SIZES_M = ((0.28, 0.28), (0.36, 0.30), (0.40, 0.30))
SPREAD = ("cell.motor_spread=0.3", "cell.friction_spread=0.3")
WITHIN_M, WITHIN_RAD = 0.005, np.radians(2.0)
CELLS = 18
RUNNING_S, LIMIT_S = 0.6, 14.0
#: At rest for so long it is over.
REST_S, REST_M_S, REST_RAD_S = 1.5, 5e-4, 2e-3
MOVING_M_S = 0.005
EDGES = 3
#: So many draws of a start and a goal, all refused, are an error.
DRAWS = 1000
CONFIDENCE = 0.95
#: The beliefs of every so many beats are taken.
STRIDE = 4


@dataclass
class Errors:
    """How far beliefs were off: position [m] and yaw [rad], moving and at rest."""

    moving: list[tuple[float, float]] = field(default_factory=list)
    resting: list[tuple[float, float]] = field(default_factory=list)

    def percentile_95(self, what: str) -> tuple[float, float]:
        """Position [mm] and yaw [degrees]."""
        errors = np.array(getattr(self, what) or [(np.nan, np.nan)])
        off_m, off_rad = np.percentile(errors, 95, axis=0)
        return 1e3 * float(off_m), float(np.degrees(off_rad))


class Watching:
    """Compares what cells and host believe with the truth, beat by beat."""

    def __init__(
        self, simulation: Simulation, coordinator: Coordinator, cells: Errors, host: Errors
    ) -> None:
        self._simulation = simulation
        self._coordinator = coordinator
        self._cells, self._host = cells, host
        self._reports = CellReports(coordinator.layout.cell_positions_m, address_cells(CELLS))
        self._presence: dict[int, int] = {}
        self._edges = 0
        self._beat = 0
        gone_s = (each.start_s for each in simulation.world.scenario.fault if each.kind == "host")
        self._gone_s = min(gone_s, default=np.inf)
        self._truth: tuple[float, np.ndarray, np.ndarray] | None = None
        self._estimate: np.ndarray | None = None
        simulation.bus.observe(self._on_frame)

    def _on_frame(self, frame: Frame, now_ns: int) -> None:
        if frame.can_id == cob.SYNC:
            self._compare()
            self._on_sync(now_ns / 1e9)
        elif frame.can_id in self._reports.cells[0]:
            self._reports.on_frame(0, frame, now_ns / 1e9)
        elif 0 < frame.can_id - cob.TPDO_BASES[1] <= CELLS:
            self._on_status(frame)

    def _on_status(self, frame: Frame) -> None:
        values = pdo.STATUS.decode(frame.data)
        if values is not None:
            before = self._presence.get(frame.can_id, values[-1])
            self._presence[frame.can_id] = values[-1]
            self._edges += (before ^ values[-1]).bit_count()

    def _on_sync(self, now_s: float) -> None:
        self._beat += 1
        self._truth = None
        if self._beat % STRIDE or self._edges < EDGES:
            return
        pose, twist = self._simulation.world.motion
        self._truth = now_s, pose[0].copy(), twist[0].copy()
        estimate = self._coordinator.tracker.estimate("box", now_s)
        self._estimate = None
        if estimate is not None and now_s < self._gone_s:
            self._estimate = np.array([estimate.x_m, estimate.y_m, estimate.yaw_rad])

    def _compare(self) -> None:
        """Take in the reports of the last SYNC."""
        if self._truth is None:
            return
        sync_s, pose, twist = self._truth
        moving = is_moving(twist)
        reports = self._reports.sample(sync_s + 0.01)
        for belief, state in zip(reports["belief"], reports["state"], strict=True):
            if state == wire.UNDER and np.isfinite(belief).all():
                getattr(self._cells, moving).append(off(belief, pose))
        if self._estimate is not None:
            getattr(self._host, moving).append(off(self._estimate, pose))


def is_moving(twist: np.ndarray) -> str:
    """The name of the errors that a beat belongs to."""
    return "moving" if hypot(*twist[:2]) > MOVING_M_S or abs(twist[2]) > 0.02 else "resting"


def off(belief: np.ndarray, pose: np.ndarray) -> tuple[float, float]:
    """Distance [m] and turn [rad] between two poses of a box that looks the same turned by pi."""
    turn_rad = (belief[2] - pose[2] + pi / 2) % pi - pi / 2
    return hypot(*(belief - pose)[:2]), abs(turn_rad)


def scenario_of(seed: int, *overrides: str) -> Scenario:
    """The first start and goal of a seed that no rule refuses."""
    random = Random(seed)
    for _ in range(DRAWS):
        length_m, width_m = random.choice(SIZES_M)
        start = (random.uniform(-0.2, 0.2), random.uniform(-0.05, 0.05), random.uniform(-pi, pi))
        turn_rad = random.uniform(-pi / 2, pi / 2)
        goal = (random.uniform(-0.2, 0.2), random.uniform(-0.05, 0.05), start[2] + turn_rad)
        values = {"length_m": length_m, "width_m": width_m}
        values |= dict(zip(("x_m", "y_m", "yaw_rad"), start, strict=True))
        values |= dict(zip(("goal.x_m", "goal.y_m", "goal.yaw_rad"), goal, strict=True))
        keys = [f"parcel.0.{key}={value}" for key, value in values.items()]
        try:
            scenario, _ = open_program(
                "neighbours",
                [*keys, *SPREAD, f"run.seed={seed}", f"run.duration_s={LIMIT_S}", *overrides],
            )
            return scenario
        except InputError as error:
            refused = error
    raise refused


@dataclass
class Tally:
    """How the cases of a kind, by their seeds, have ended, and how far beliefs were off in them."""

    arrived: list[int] = field(default_factory=list)
    missed: list[int] = field(default_factory=list)
    fallen: list[int] = field(default_factory=list)
    cells: Errors = field(default_factory=Errors)
    host: Errors = field(default_factory=Errors)


def case(scenario: Scenario, tally: Tally) -> None:
    """One box on its way until it has been at rest for a while, or fallen off."""
    goal = scenario.parcel[0].goal
    assert goal is not None
    coordinator = coordinator_of(scenario)
    with closing(PythonBank(range(1, CELLS + 1))) as bank:
        simulation = Simulation(scenario, bank, [coordinator], recording=None)
        Watching(simulation, coordinator, tally.cells, tally.host)
        time_s, still_s = RUNNING_S, 0.0
        while time_s < LIMIT_S and still_s < REST_S and not simulation.tipped:
            time_s += 0.05
            simulation.run_until(time_s)
            twist = simulation.world.motion[1][0]
            still = hypot(*twist[:2]) < REST_M_S and abs(twist[2]) < REST_RAD_S
            still_s = still_s + 0.05 if still else 0.0
        off_m, off_rad = off(
            np.array([goal.x_m, goal.y_m, goal.yaw_rad]), simulation.world.motion[0][0]
        )
    arrived = off_m <= WITHIN_M and off_rad <= WITHIN_RAD and not simulation.tipped
    (tally.arrived if arrived else tally.missed).append(scenario.run.seed)
    if simulation.tipped:
        tally.fallen.append(scenario.run.seed)


def kinds(seed: int) -> dict[str, tuple[str, ...]]:
    """The overrides of each kind of case, by seed."""
    random = Random(f"kind {seed}")
    gone_s, dead_s = random.uniform(0.8, 3.0), random.uniform(1.0, 3.0)
    gone = f"{{kind='host', start_s={gone_s}}}"
    dead = f"{{kind='off', start_s={dead_s}, cells=[{random.randint(1, CELLS)}]}}"
    early = "{kind='host', start_s=1.0}"
    return {
        "all well": (),
        "1 % sensor noise": ("cell.sensor_noise=0.01",),
        # A host that is there stops the array when a cell has fallen silent.
        "one cell dead, host gone, go on": ("motion.go_on=true", f"fault=[{early}, {dead}]"),
        "host killed, go on": ("motion.go_on=true", f"fault=[{gone}]"),
    }


def at_least(successes: int, cases: int) -> float:
    """Lower bound of a share, one-sided, by Clopper and Pearson."""
    if not successes:
        return 0.0
    low, high = 0.0, successes / cases
    for _ in range(50):
        share = (low + high) / 2
        tail = sum(
            comb(cases, k) * share**k * (1 - share) ** (cases - k)
            for k in range(successes, cases + 1)
        )
        low, high = (share, high) if tail < 1 - CONFIDENCE else (low, share)
    return low


def rows(kind: str, tally: Tally) -> Iterator[dict[str, Any]]:
    """The share that arrives, and the beliefs of cells beside the host's estimate."""
    arrived, cases = len(tally.arrived), len(tally.arrived) + len(tally.missed)
    yield {
        "name": f"{kind}: arrived",
        "ours": 100 * arrived / cases,
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * at_least(arrived, cases),
        "cases": cases,
        "missed": " ".join(map(str, tally.missed)) or None,
        "fallen": " ".join(map(str, tally.fallen)) or None,
    }
    for what in ("moving", "resting"):
        ours, hosts = tally.cells.percentile_95(what), tally.host.percentile_95(what)
        for unit, number, name in (("mm", 0, "place"), ("degrees", 1, "turn")):
            yield {
                "name": f"{kind}: {name} {what}, 95 %",
                "ours": ours[number],
                "peer": hosts[number],
                "ratio": ours[number] / hosts[number],
                "unit": unit,
                "beliefs": len(getattr(tally.cells, what)),
            }


def run() -> list[dict[str, Any]]:
    """A share and four percentiles for each kind of case; `peer` is the host's own estimate."""
    cases = int(os.environ.get("MDMS_CASES", "20"))
    first = int(os.environ.get("MDMS_SEED", "1"))
    chosen = os.environ.get("MDMS_KIND", "")
    seeds = range(first, first + cases)
    print(
        f"MDMS_CASES={cases} MDMS_SEED={first} MDMS_KIND='{chosen}' "
        "python -m tests.benchmarks neighbours: seeds "
        f"{seeds[0]} to {seeds[-1]}; bounds one-sided, {CONFIDENCE:.0%}",
        flush=True,
    )
    table: list[dict[str, Any]] = []
    for kind in (name for name in kinds(first) if name.startswith(chosen)):
        tally = Tally()
        for seed in seeds:
            case(scenario_of(seed, *kinds(seed)[kind]), tally)
        table += rows(kind, tally)
        print(f"  {kind}: missed {tally.missed}, fallen {tally.fallen}", flush=True)
    return table
