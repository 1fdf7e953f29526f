"""Random well-formed instances of many parcels: does every parcel arrive, and touch no other?

Parcels are drawn one after another. Each either has a way past the goals of all drawn before, and
starts where none of their ways passes, or it has one past their starts, and ends where none of
their ways passes: so it can be the last to go, or the first, and there is an order in which they
could go, which the planner is not given. What it plans is checked by outlines of `shapely` in
continuous time, which has no code in common with it: swept over short spans of time, and looked at
closer where two spans come near. Times are of the processor, for all parcels at once (`ours`) and
for one that is planned anew while the others keep their routes (`one_ms`); `anew` is in how many
instances somebody would have waited for it for ever, so that all were planned anew.
`bound` is the upper end of a one-sided 95 % confidence interval of the share that fails.

`python -m tests.benchmarks.host.routes [--instances N] [--seed S] [--seconds T]` prints
more of it, by table.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from math import ceil, hypot, inf
from random import Random
from time import monotonic, process_time
from typing import Any

import numpy as np
from shapely import affinity
from shapely.geometry import MultiPoint, Point, Polygon, box

from mdms_host.estimation.outlines.disc import Disc
from mdms_host.estimation.outlines.rectangle import Rectangle
from mdms_host.layout import Layout
from mdms_host.routes.errand import Task
from mdms_host.routes.planner import Plan, Planner
from mdms_host.routes.route import Route
from mdms_host.routes.space.shape import Shape
from mdms_host.routes.space.tiles import Tiles

SHAPES = (
    Shape(Rectangle(0.28, 0.28)),
    Shape(Rectangle(0.36, 0.30)),
    Shape(Rectangle(0.40, 0.30)),
    Shape(Disc(0.30)),
)
SPEED_M_S, ACCELERATION_M_S2 = 0.3, 0.6
#: Spans in which outlines are swept, and the finest ones [s].
SPAN_S, FINEST_S = 0.25, 0.002
#: How far over the edge is rounding [m].
EDGE_M = 5e-6
#: Draws of a parcel before an instance is begun anew, and how often that is done.
DRAWS, BEGINS = 60, 15
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Table:
    """A table and how many parcels are on it at most."""

    columns: int
    rows: int
    parcels: int
    step: int

    @cached_property
    def layout(self) -> Layout:
        cells = range(self.columns * self.rows)
        nodes, buses = tuple(n % 100 + 1 for n in cells), tuple(n // 100 for n in cells)
        return Layout(self.columns, self.rows, node_ids=nodes, buses=buses)

    @cached_property
    def planner(self) -> Planner:
        return Planner(Tiles(self.layout, 2), step=self.step)


TABLES = (Table(9, 6, 3, 1), Table(18, 10, 8, 1), Table(30, 20, 20, 2))


# Instances ----------------------------------------------------------------------------------------


def drawn_pose(random: Random, table: Table, shape: Shape) -> np.ndarray:
    """A pose on the table; most are along it, some are turned anyhow."""
    tidy = random.random() < 0.7
    yaw_rad = random.choice((0, 1, 2, 3)) * np.pi / 2 if tidy else random.uniform(-np.pi, np.pi)
    corners_m = shape.bottom.outline_m(np.array([0.0, 0.0, yaw_rad]))
    half_m = np.array([table.columns, table.rows]) * table.layout.pitch_m / 2
    low_m, high_m = -half_m - corners_m.min(axis=0), half_m - corners_m.max(axis=0)
    place_m = [*map(random.uniform, low_m, high_m)]
    if random.random() < 0.5:
        # Along an edge, so that tables get fuller than by chance.
        axis = random.randrange(2)
        place_m[axis] = random.choice((low_m[axis], high_m[axis]))
    return np.array([*place_m, yaw_rad])


def instance(table: Table, seed: int, draws: int = DRAWS, begins: int = BEGINS) -> list[Task]:
    """Parcels of a table, shuffled: the most of several begins that does not reach the number."""
    random = Random(f"routes {table.columns} x {table.rows} {seed}")
    count = random.randint(1, 3) if table.parcels == 3 else table.parcels
    best: list[Task] = []
    for _ in range(begins):
        tasks = begun(table, random, count, draws)
        best = max(best, tasks, key=len)
        if len(best) == count:
            break
    random.shuffle(best)
    return [
        Task(f"parcel {number}", task.shape, task.ahead, task.goal)
        for number, task in enumerate(best)
    ]


def begun(table: Table, random: Random, count: int, draws: int) -> list[Task]:
    """Parcels drawn one after another; one that finds no place in so many draws is left out."""
    tasks: list[Task] = []
    starts, goals, ways = np.zeros((3, table.planner.tiles.count), dtype=bool)
    for _ in range(count):
        for _ in range(draws):
            shape = random.choice(SHAPES)
            start, goal = (drawn_pose(random, table, shape) for _ in range(2))
            start_tiles = table.planner.stand(shape, start)
            goal_tiles = table.planner.stand(shape, goal)
            if starts[start_tiles].any() or goals[goal_tiles].any():
                continue
            # It is the last to go, or the first.
            if not ways[start_tiles].any():
                passed = goals
            elif not ways[goal_tiles].any():
                passed = starts
            else:
                continue
            task = Task("", shape, start[None], goal)
            route = table.planner.plan([task], closed=passed).routes[""]
            if route.poses.shape[0] == 1:
                continue
            tasks.append(task)
            starts[start_tiles], goals[goal_tiles] = True, True
            ways[route.visits.tile] = True
            break
    return tasks


# The checker --------------------------------------------------------------------------------------


def outline(shape: Shape) -> Polygon:
    """The outline about its own centre."""
    bottom = shape.bottom
    if isinstance(bottom, Disc):
        return Point(0.0, 0.0).buffer(bottom.diameter_m / 2, quad_segs=16)
    assert isinstance(bottom, Rectangle)
    half_x_m, half_y_m = bottom.length_m / 2, bottom.width_m / 2
    return box(-half_x_m, -half_y_m, half_x_m, half_y_m)


def share_done(way_m: float, since_s: float) -> float:
    """How much of a move from rest to rest is done a while after its begin."""
    ramp_s = min(SPEED_M_S / ACCELERATION_M_S2, (way_m / ACCELERATION_M_S2) ** 0.5)
    top_m_s = ramp_s * ACCELERATION_M_S2
    lasts_s = way_m / top_m_s + ramp_s
    if since_s <= 0.0 or since_s >= lasts_s:
        return float(since_s > 0.0)
    if since_s < ramp_s:
        return ACCELERATION_M_S2 * since_s**2 / 2 / way_m
    left_s = lasts_s - since_s
    if left_s < ramp_s:
        return 1.0 - ACCELERATION_M_S2 * left_s**2 / 2 / way_m
    return (since_s - ramp_s / 2) * top_m_s / way_m


def pose_at(route: Route, shape: Shape, time_s: float) -> np.ndarray:
    """Where a parcel is that keeps to its times."""
    pose = route.poses[0]
    reach_m = 0.0 if isinstance(shape.bottom, Disc) else shape.bottom.reach_m
    for index, begin_s in enumerate(route.begins_s.tolist()):
        if time_s <= begin_s:
            break
        start, end = route.poses[index], route.poses[index + 1]
        way = end - start
        way_m = hypot(way[0], way[1], way[2] * reach_m)
        pose = start + way * share_done(way_m, time_s - begin_s)
    return pose


@dataclass
class Swept:
    """Outlines over spans of time; spans are kept, since every pair asks for the same ones."""

    task: Task
    route: Route
    spans: dict[tuple[float, float], Polygon] = field(default_factory=dict)

    def at(self, time_s: float) -> Polygon:
        x_m, y_m, yaw_rad = pose_at(self.route, self.task.shape, time_s)
        turned = affinity.rotate(outline(self.task.shape), yaw_rad, (0, 0), use_radians=True)
        return affinity.translate(turned, x_m, y_m)

    def over(self, from_s: float, to_s: float) -> Polygon:
        """What the outline meets within a span, and a little more: what a turn bulges out."""
        if (from_s, to_s) not in self.spans:
            begins, ends = (
                pose_at(self.route, self.task.shape, from_s),
                pose_at(self.route, self.task.shape, to_s),
            )
            if (begins == ends).all():
                hull = self.at(from_s)
            else:
                inner = np.concatenate((self.route.begins_s, self.route.arrives_s)).tolist()
                times = [from_s, *(t for t in inner if from_s < t < to_s), to_s]
                parts = np.concatenate([np.array(self.at(t).exterior.coords) for t in times])
                turn_rad = SPEED_M_S * (to_s - from_s) / self.task.shape.bottom.reach_m
                bulge_m = self.task.shape.bottom.reach_m * (1 - np.cos(turn_rad / 2))
                hull = MultiPoint(parts).convex_hull.buffer(bulge_m)
            self.spans[from_s, to_s] = hull
        return self.spans[from_s, to_s]


def touch(one: Swept, other: Swept, from_s: float, to_s: float) -> bool:
    """Whether two outlines may meet within a span."""
    if not one.over(from_s, to_s).intersects(other.over(from_s, to_s)):
        return False
    middle_s = (from_s + to_s) / 2
    if to_s - from_s < FINEST_S:
        return True
    return touch(one, other, from_s, middle_s) or touch(one, other, middle_s, to_s)


def faults(table: Table, tasks: list[Task], plan: Plan) -> list[str]:
    """What is wrong with a plan: who does not arrive, leaves the table, or touches whom."""
    found = [str(blocked) for blocked in plan.blocked.values()]
    swept = [Swept(task, plan.routes[task.parcel]) for task in tasks]
    half_x_m = table.columns * table.layout.pitch_m / 2 + EDGE_M
    half_y_m = table.rows * table.layout.pitch_m / 2 + EDGE_M
    floor = box(-half_x_m, -half_y_m, half_x_m, half_y_m)
    end_s = max((route.end_s for route in plan.routes.values()), default=0.0)
    spans = ceil(max(end_s, 0.0) / SPAN_S) + 1
    for index, one in enumerate(swept):
        away = one.route.poses[-1] - one.task.goal
        turned = 0.0 if one.task.shape.round else (away[2] + np.pi) % (2 * np.pi) - np.pi
        if hypot(*away[:2]) > 1e-9 or abs(turned) > 1e-9:
            found.append(f"{one.task.parcel} ends elsewhere")
        for span in range(spans):
            from_s, to_s = span * SPAN_S, (span + 1) * SPAN_S
            if not floor.buffer(0.002).contains(one.over(from_s, to_s)):
                steps = np.linspace(from_s, to_s, 60)
                if not all(floor.contains(one.at(time_s)) for time_s in steps):
                    found.append(f"{one.task.parcel} hangs over the edge at {from_s} s")
            for other in swept[:index]:
                if touch(one, other, from_s, to_s):
                    found.append(f"{one.task.parcel} touches {other.task.parcel} at {from_s} s")
    return found


# Counting -----------------------------------------------------------------------------------------


@dataclass
class Count:
    """What came of the instances of a table."""

    instances: int = 0
    parcels: int = 0
    full: int = 0
    """Instances of as many parcels as the table may have."""
    bad: list[str] = field(default_factory=list)
    anew: int = 0
    """Instances of which all were planned anew where one was to be."""
    all_ms: list[float] = field(default_factory=list)
    one_ms: list[float] = field(default_factory=list)


def try_one(table: Table, seed: int, count: Count) -> None:
    """One instance: plan all, check, then plan one anew among the others' routes."""
    tasks = instance(table, seed)
    begun_s = process_time()
    plan = table.planner.plan(tasks)
    assert len(plan.reservations.waits) == len(tasks)  # they are worked out when asked for
    count.all_ms.append((process_time() - begun_s) * 1e3)
    count.instances += 1
    count.parcels += len(tasks)
    count.full += len(tasks) == table.parcels
    one = Random(seed).choice(tasks)
    begun_s = process_time()
    others_m = {task.parcel: 0.0 for task in tasks if task is not one}
    again = table.planner.plan([one], kept=table.planner.kept(plan, others_m, 0.0))
    if again.blocked or again.authority.held(dict.fromkeys(again.routes, 0.0), ()):
        # As on a table: who waits for it for ever is stopped, and all are planned anew.
        again = table.planner.plan(tasks)
        count.anew += 1
    assert len(again.reservations.waits) == len(tasks)
    count.one_ms.append((process_time() - begun_s) * 1e3)
    wrong = faults(table, tasks, plan) + faults(table, tasks, again)
    if wrong:
        count.bad.append(f"seed {seed}: {'; '.join(wrong)}")


def share_bound(bad: int, runs: int) -> float:
    """The share that is not exceeded with 95 % confidence (Clopper and Pearson)."""
    low, high = bad / max(runs, 1), 1.0
    for _ in range(50):
        share = (low + high) / 2
        term, total = (1 - share) ** runs, 0.0
        for k in range(bad + 1):
            total += term
            term *= (runs - k) / (k + 1) * share / (1 - share)
        low, high = (share, high) if total > 1 - CONFIDENCE else (low, share)
    return high


def rows_of(instances: int, seed: int, seconds: float = inf) -> Iterator[dict[str, Any]]:
    """So many instances of each table, or as many as so long a time allows."""
    for table in TABLES:
        count = Count()
        try_one(table, seed - 1, Count())  # what is worked out once a shape, and compiled
        end_s = monotonic() + seconds
        for number in range(instances):
            if monotonic() < end_s:
                try_one(table, seed + number, count)
        yield (
            {
                "name": f"routes: {table.parcels} on {table.columns} x {table.rows}, all planned",
                "ours": float(np.percentile(count.all_ms, 99)),
                "peer": None,
                "ratio": None,
                "unit": "ms (p99)",
                "median_ms": float(np.median(count.all_ms)),
                "one_ms": float(np.percentile(count.one_ms, 99)),
                "one_median_ms": float(np.median(count.one_ms)),
                "instances": count.instances,
                "parcels": count.parcels,
                "full": count.full,
                "anew": count.anew,
                "bad": len(count.bad),
                "bound": share_bound(len(count.bad), count.instances),
                "seeds": f"{seed}..{seed + count.instances - 1}",
                "first_bad": count.bad[:3],
            }
        )


def run() -> list[dict[str, Any]]:
    """Some of it, for the table of all benchmarks."""
    return list(rows_of(30, 1, seconds=60.0))


def main() -> None:
    """As many as are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instances", type=int, default=100, help="of each table")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=inf, help="for each table at most")
    options = parser.parse_args()
    for row in rows_of(options.instances, options.seed, options.seconds):
        print(json.dumps(row, indent=1), flush=True)


if __name__ == "__main__":
    main()
