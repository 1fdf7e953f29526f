"""The cost of following many parcels, and the accuracy of sizes that nobody told.

`python -m tests.benchmarks parcels` prints

- processor time of a cycle of the tracker, with 20 parcels on 30 x 20 cells that all move;
- how far the size of an unknown box is off: by the sensors at rest, and after 9 s on real firmware
  in which its wheels move it to and fro by 0.08 m along x and y, and turn it by 17 degrees. Wheels
  are believed to be 1 % larger than they are.

Boxes are drawn by seed; `PARCELS_RUNS` in the environment is how many are learned (10).
"""

import os
from collections.abc import Mapping
from multiprocessing import get_context
from random import Random
from time import process_time

import numpy as np

from mdms_array.host import layout_of, settings_of
from mdms_host.coordination.bring_up import ExpectedCells
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.tracker import Parcel, Tracker
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.program import FieldProgram
from mdms_model.arrays import Floats
from mdms_model.motor import drive_of
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import simulate

PROCESSES = 2
RUNS = int(os.environ.get("PARCELS_RUNS", "10"))
CYCLES = 300
STEP_S = 0.01
#: The twists that a box is moved by, and for how long [m/s, m/s, rad/s; s].
LEGS = (
    ((0.05, 0.0, 0.0), 1.6),
    ((0.0, 0.05, 0.0), 0.8),
    ((-0.05, 0.0, 0.0), 1.6),
    ((0.0, -0.05, 0.0), 1.6),
    ((0.0, 0.0, 0.2), 1.5),
    ((0.0, 0.0, -0.2), 1.5),
)
Row = dict[str, object]


class Learning(FieldProgram):
    """Names an unknown parcel by its size at rest, then moves it to and fro."""

    def __init__(self, layout: Layout, droop: float) -> None:
        super().__init__(np.zeros(len(layout.wheel_cells)))
        self.tracker: Tracker | None = None
        self._layout = layout
        self._droop = droop
        self._now_s = 0.0
        self.rough: tuple[float, float] | None = None

    def references_m_s(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References for the leg of now."""
        assert self.tracker is not None
        nothing = np.zeros(len(self._layout.wheel_cells))
        if "unknown-1" in beliefs and self.rough is None:
            size = self.tracker.size("unknown-1")
            if size is not None:
                self.rough = size.length_m, size.width_m
                self.tracker.name("unknown-1", size.parcel("box"))
        if "box" not in beliefs:
            return nothing
        self._now_s += step_s
        left_s = self._now_s
        for twist, seconds in LEGS:
            if left_s < seconds:
                belief = beliefs["box"]
                near = belief.outline.distance_m(self._layout.wheel_positions_m, belief.pose) < 0.05
                jacobian = self._layout.surface_jacobian(*belief.pose[:2].tolist())
                return np.where(near, jacobian @ np.array(twist) / self._droop, 0.0)
            left_s -= seconds
        return nothing


def learned(seed: int) -> tuple[list[float], list[float], list[float]]:
    """The error of the size of a box: at rest, after it has moved, and its standard deviations."""
    random = Random(f"parcels/{seed}")
    sides_m = sorted((random.uniform(0.24, 0.40), random.uniform(0.24, 0.34)), reverse=True)
    keys = [
        f"run.seed={seed}",
        "run.duration_s=9.8",
        "motion.field='uniform'",
        f"parcel.0.length_m={sides_m[0]}",
        f"parcel.0.width_m={sides_m[1]}",
        f"parcel.0.x_m={random.uniform(-0.08, 0.0)}",
        f"parcel.0.y_m={random.uniform(-0.03, 0.0)}",
        f"parcel.0.yaw_rad={random.uniform(-0.4, 0.4)}",
        "belief.wheel_radius_m=0.025654",
    ]
    scenario = load_scenario("array18", keys)
    layout = layout_of(scenario)
    program = Learning(layout, drive_of(scenario.cell).droop)
    coordinator = Coordinator(layout, program, expected=ExpectedCells(settings_of(scenario.cell)))
    program.tracker = coordinator.tracker
    simulate(scenario, [coordinator])
    size = coordinator.tracker.size("box")
    assert size is not None
    assert program.rough is not None
    # Which side of a box that is nearly square is called its length is anybody's guess.
    after = sorted(((size.length_m, size.deviation_m[0]), (size.width_m, size.deviation_m[1])))
    longest_first = after[::-1]
    rough = [abs(a - b) for a, b in zip(sorted(program.rough)[::-1], sides_m, strict=True)]
    off = [abs(side_m - b) for (side_m, _), b in zip(longest_first, sides_m, strict=True)]
    return rough, off, [deviation_m for _, deviation_m in longest_first]


def sizes() -> list[Row]:
    """How far learned sizes are off."""
    with get_context("spawn").Pool(PROCESSES) as pool:
        done = pool.map(learned, range(1, RUNS + 1), chunksize=1)
    rough, after, sigma = (1e3 * np.array([one[number] for one in done]) for number in range(3))
    return [
        _row("size off at rest, median", float(np.median(rough)), "mm", worst=float(rough.max())),
        _row("size off after moving, median", float(np.median(after)), "mm", worst=after.max()),
        _row("stated standard deviation then, median", float(np.median(sigma)), "mm")
        | {"worst_off_in_deviations": float((after / sigma).max())},
    ]


def cycle() -> list[Row]:
    """Processor time of a cycle with 20 parcels."""
    wheels = (WheelPlace(0.0, (-0.03, 0.0)), WheelPlace(np.pi / 2, (0.03, 0.0)))
    buses = tuple(np.repeat(np.arange(6), 100).tolist())
    layout = Layout(30, 20, wheels=wheels, node_ids=(*range(1, 101),) * 6, buses=buses)
    footprint, sensors_m = Rectangle(0.36, 0.30), layout.sensor_positions_m.reshape(-1, 2)
    poses = [
        np.array([-1.5 + 0.7 * column, -0.9 + 0.6 * row, 0.1 * column])
        for row in range(4)
        for column in range(5)
    ]
    tracker = Tracker(layout, tuple(Parcel(f"box-{n}", 0.36, 0.30) for n in range(len(poses))))
    twist = np.array([0.1, 0.02, 0.05])
    times_s, searching_s, now_s = [], [], 0.0
    moving = False
    for _ in range(CYCLES):
        now_s += STEP_S
        moving = moving or len(tracker.poses(now_s)) == len(poses)
        speeds_m_s, covered = (
            np.zeros(len(layout.wheel_cells)),
            np.zeros(len(sensors_m), dtype=bool),
        )
        for number, pose in enumerate(poses):
            if moving:
                under = footprint.distance_m(layout.wheel_positions_m, pose) < 0.03
                speeds_m_s[under] = (layout.surface_jacobian(*pose[:2].tolist()) @ twist)[under]
                poses[number] = pose + twist * STEP_S
            covered |= footprint.distance_m(sensors_m, poses[number]) < 0
        begun_s = process_time()
        bits = covered.reshape(layout.cells, -1) @ (1 << np.arange(5))
        for cell, each in enumerate(bits.tolist(), 1):
            tracker.on_presence(now_s, cell, each)
        between_s = process_time()
        tracker.on_speeds(now_s, speeds_m_s)
        tracker.beliefs(now_s, now_s)
        over_s = process_time()
        if moving:
            times_s.append((over_s - between_s, between_s - begun_s))
        else:
            searching_s.append(over_s - between_s)
    cycles_ms, reports_ms = 1e3 * np.array(times_s).T
    return [
        _row("cycle of 20 parcels on 30 x 20", float(np.median(cycles_ms)), "ms")
        | {"p99": float(np.percentile(cycles_ms, 99)), "parcels": len(tracker.poses(now_s))},
        _row("the same while all are searched for", 1e3 * float(np.median(searching_s)), "ms")
        | {"worst": 1e3 * max(searching_s), "cycles": len(searching_s)},
        _row("taking in what 600 cells report", float(np.median(reports_ms)), "ms"),
    ]


def _row(name: str, ours: float, unit: str, **more: object) -> Row:
    return {"name": name, "ours": ours, "peer": None, "ratio": None, "unit": unit} | more


def run() -> list[Row]:
    """Both."""
    return [*cycle(), *sizes()]
