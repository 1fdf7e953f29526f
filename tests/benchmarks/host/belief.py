"""The quality of the host's belief of a parcel, against the truth of the simulation.

`python -m tests.benchmarks belief` carries a box of 0.36 m x 0.30 m over 18 cells, from places to
others that are drawn by seed, and prints

- how often the truth lies inside the 95 % region that the belief states, after three edges, every
  20 mm of way and once at rest, and how far the belief is off then; sizes and wheels are about as
  exact as they are told (1 mm and 1 % as standard deviations);
- in how many runs the host takes the box for arrived where it is not, within 5 mm and 0.03 rad;
  in every third the box is up to 20 mm longer, shorter, wider or narrower than told;
- in how many it arrives with presence sensors that read wrong 1 % of the time (1 kHz), and with all
  five sensors of one cell stuck besides.

`BELIEF_RUNS` in the environment is how many runs the second has (600).
"""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import hypot, pi, sqrt
from multiprocessing import get_context
from random import Random

import numpy as np

from mdms_array.host import coordinator_of
from mdms_host.estimation.tracker import Tracker
from mdms_host.motion.outcome import REACHED_M, REACHED_RAD
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import simulate

PROCESSES = 2
COVERED_SEEDS = range(1, 51)
ARRIVAL_RUNS = int(os.environ.get("BELIEF_RUNS", "600"))
NOISY_SEEDS = range(1, 21)
DURATION_S = 9.0
#: The 95 % quantile of chi squared with three degrees of freedom.
REGION = 7.815
#: Beliefs so far apart count as different ones.
APART_M = 0.02
Row = dict[str, object]


@dataclass(frozen=True, slots=True)
class Ride:
    """One run: the truth and the belief at instants after three edges, and how it ended."""

    seed: int
    off: tuple[tuple[float, float, float], ...]
    inside: tuple[bool, ...]
    arrived: bool
    miss_m: float
    miss_rad: float
    faults: tuple[str, ...]


def keys_of(seed: int) -> list[str]:
    """A start and a goal, drawn."""
    random = Random(f"belief/{seed}")
    start = goal = (0.0, 0.0, 0.0)
    while hypot(start[0] - goal[0], start[1] - goal[1]) < 0.1:
        start = _drawn(random, 0.35)
        goal = _drawn(random, 0.5)
    keys = ("x_m", "y_m", "yaw_rad")
    return [
        f"run.seed={seed}",
        f"run.duration_s={DURATION_S}",
        *(f"parcel.0.{key}={value}" for key, value in zip(keys, start, strict=True)),
        *(f"parcel.0.goal.{key}={value}" for key, value in zip(keys, goal, strict=True)),
    ]


def _drawn(random: Random, turn_rad: float) -> tuple[float, float, float]:
    turned_rad = random.uniform(-turn_rad, turn_rad)
    return random.uniform(-0.17, 0.17), random.uniform(-0.03, 0.03), turned_rad


def about_right(seed: int) -> list[str]:
    """Sizes and wheels about as exact as they are told."""
    random = Random(f"about/{seed}")
    return [
        f"belief.box.length_m={0.36 + random.gauss(0, 0.001)}",
        f"belief.box.width_m={0.30 + random.gauss(0, 0.001)}",
        f"belief.wheel_radius_m={0.0254 * (1 + random.gauss(0, 0.01))}",
    ]


def slightly_wrong(seed: int) -> list[str]:
    """Every third box is up to 20 mm larger or smaller than told, one way or the other."""
    if seed % 3:
        return about_right(seed)
    random = Random(f"wrong/{seed}")
    side, told_m = random.choice((("length", 0.36), ("width", 0.30)))
    return [f"belief.box.{side}_m={told_m + random.uniform(-0.02, 0.02)}"]


def noisy(seed: int) -> list[str]:
    """Readings of presence sensors are wrong 1 % of the time."""
    return ["cell.sensor_noise=0.01"]


def stuck(seed: int) -> list[str]:
    """The same, and one cell has all five of its sensors stuck, from the start or later."""
    random = Random(f"stuck/{seed}")
    covered = random.choice(("true", "false"))
    start_s = random.choice((0.0, random.uniform(0.5, 2.0)))
    fault = f"kind='sensor_stuck', cells=[{random.randint(1, 18)}], covered={covered}"
    return ["cell.sensor_noise=0.01", f"fault=[{{{fault}, start_s={start_s}}}]"]


def ride(seed: int, more: Callable[[int], list[str]]) -> Ride:
    """Carry the box of a seed."""
    scenario = load_scenario("array18", [*keys_of(seed), *more(seed)])
    coordinator = coordinator_of(scenario)
    instants = _Instants(coordinator.tracker)
    record = simulate(scenario, [coordinator]).record
    (goal,) = [parcel.goal for parcel in scenario.parcel]
    assert goal is not None
    x_m, y_m, yaw_rad = record.pose[-1, 0].tolist()
    ways = record.pose[:, 0].T
    off = [
        _off(believed, [float(np.interp(time_s, record.time_s, way)) for way in ways])
        for time_s, believed, _ in instants.kept
    ]
    inside = [
        bool(each @ np.linalg.solve(covariance, each) <= REGION)
        for each, (_, _, covariance) in zip(off, instants.kept, strict=True)
    ]
    return Ride(
        seed,
        tuple((float(each[0]), float(each[1]), float(each[2])) for each in off),
        tuple(inside),
        "box" in coordinator.arrived_s,
        hypot(x_m - goal.x_m, y_m - goal.y_m),
        abs((yaw_rad - goal.yaw_rad + pi) % (2 * pi) - pi),
        tuple(text for _, text in coordinator.troubles),
    )


class _Instants:
    """Keeps a tracker's beliefs every 20 mm of way from the third edge on, and the last one."""

    def __init__(self, tracker: Tracker) -> None:
        self._kept: list[tuple[float, np.ndarray, np.ndarray]] = []
        self._tracker = tracker
        self._bits: dict[int, int] = {}
        self._edges = 0
        self._last: tuple[float, np.ndarray, np.ndarray] | None = None
        self._on_presence, self._on_speeds = tracker.on_presence, tracker.on_speeds
        vars(tracker).update(on_presence=self._presence, on_speeds=self._speeds)

    def _presence(self, now_s: float, cell: int, bits: int) -> None:
        if cell in self._bits and self._tracker.poses(now_s):
            self._edges += (self._bits[cell] ^ bits).bit_count()
        self._bits[cell] = bits
        self._on_presence(now_s, cell, bits)

    def _speeds(self, now_s: float, *rest: object) -> list[str]:
        found = self._on_speeds(now_s, *rest)  # type: ignore[arg-type]
        pose = self._tracker.poses(now_s).get("box")
        if self._edges >= 3 and pose is not None:
            self._last = now_s, pose, self._tracker.covariance("box")
            if not self._kept or hypot(*(pose - self._kept[-1][1])[:2]) >= APART_M:
                self._kept.append(self._last)
        return found

    @property
    def kept(self) -> list[tuple[float, np.ndarray, np.ndarray]]:
        """Times, poses and covariances; that at rest once."""
        return self._kept if self._last is None else [*self._kept, self._last]


def _off(believed: np.ndarray, truth: list[float]) -> np.ndarray:
    """The error of a belief; a box looks the same after half a turn."""
    off: np.ndarray = believed - truth
    off[2] = (off[2] + pi / 2) % pi - pi / 2
    return off


def rides(seeds: Iterable[int], more: Callable[[int], list[str]]) -> list[Ride]:
    """Carry the boxes of these seeds, two at a time."""
    with get_context("spawn").Pool(PROCESSES) as pool:
        return pool.starmap(ride, [(seed, more) for seed in seeds], chunksize=5)


def interval(count: int, total: int) -> tuple[float, float]:
    """Wilson's 95 % bounds of a share."""
    share, z = count / total, 1.96
    middle = (share + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z / (1 + z**2 / total) * sqrt(share * (1 - share) / total + z**2 / (4 * total**2))
    return middle - half, middle + half


def coverage() -> list[Row]:
    """How often the truth is inside the stated region, and how far the belief is off."""
    done = rides(COVERED_SEEDS, about_right)
    inside = [each for one in done for each in one.inside]
    off = np.array([each for one in done for each in one.off])
    low, high = interval(sum(inside), len(inside))
    away_mm = 1e3 * np.hypot(off[:, 0], off[:, 1])
    return [
        _row("truth inside the stated 95 % region", 100 * sum(inside) / len(inside))
        | {"unit": f"% of {len(inside)}", "low_95": 100 * low, "high_95": 100 * high},
        _row("belief off, 95th percentile", float(np.percentile(away_mm, 95)))
        | {"unit": "mm", "yaw_deg": float(np.percentile(np.degrees(abs(off[:, 2])), 95))},
    ]


def arrivals() -> list[Row]:
    """Runs that were taken for arrived, and were not."""
    done = rides(range(1001, 1001 + ARRIVAL_RUNS), slightly_wrong)
    arrived = [one for one in done if one.arrived]
    wrong = [one for one in arrived if one.miss_m > REACHED_M or one.miss_rad > REACHED_RAD]
    for one in wrong:
        print(f"  seed {one.seed}: {1e3 * one.miss_m:.1f} mm, {one.miss_rad:.4f} rad")
    for one in done:
        if not one.arrived:
            print(f"  seed {one.seed}: has not arrived: {'; '.join(one.faults)}")
    bound = interval(len(wrong), len(arrived))[1] if wrong else 3 / len(arrived)
    return [
        _row("arrived, and off by more than 5 mm or 0.03 rad", len(wrong))
        | {"unit": f"of {len(arrived)}", "bound_95": bound},
        _row("arrived at all", len(arrived)) | {"unit": f"of {len(done)}"},
        _row("end error, median", 1e3 * float(np.median([one.miss_m for one in arrived])))
        | {"unit": "mm", "worst": 1e3 * max(one.miss_m for one in arrived)},
    ]


def noise() -> list[Row]:
    """Runs that arrive though sensors read wrong."""
    rows = []
    for name, more in (("1 % wrong readings", noisy), ("and a cell that is stuck", stuck)):
        done = rides(NOISY_SEEDS, more)
        good = [one for one in done if one.arrived and one.miss_m <= REACHED_M]
        for one in done:
            if one not in good:
                print(f"  seed {one.seed}: {1e3 * one.miss_m:.1f} mm off: {'; '.join(one.faults)}")
        rows.append(_row(f"arrive with {name}", len(good)) | {"unit": f"of {len(done)}"})
    return rows


def _row(name: str, ours: float) -> Row:
    return {"name": name, "ours": ours, "peer": None, "ratio": None}


def run() -> list[Row]:
    """All three."""
    return [*coverage(), *noise(), *arrivals()]
