"""Ways of many legs on cells that steer: how often there are too many, and who arrives alone.

The first rows count legs of ways that are planned for cells, over random well-formed instances of
`_route_instances`: cells are given seven, and all of a way only where it has no more. `before` is
without `routes.straightening`, and `bad` counts plans that the independent checker finds fault
with. `MDMS_INSTANCES` is the number of instances a table (default 60).

The last row is of firmware and buses of 54 cells: instances in which a parcel has been given a way
of four legs or more when the host is killed for good, at an instant that is drawn by seed. Of the
parcels that had a way by then, `arrived` are those within 5 mm and 2 degrees of their goals at
rest. `beside` are those that stand within 40 mm of them, because their places were not known
better. `blocked` ones stand elsewhere though they had all of their way. `short` ones stand at the
end of the part of their way that they had. `failed` ones are of cases in which a parcel tipped,
touched another, or still moves. `waiting` ones had no way then. `bound` is the lower end of a
one-sided 95 % confidence interval of the share that arrives (Clopper and Pearson). `MDMS_CASES` is
the number of cases (default 2), `MDMS_SEED` the first seed (default 1).
"""

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from math import hypot, pi, remainder
from random import Random
from typing import Any

from tests.benchmarks.cells.neighbours import at_least
from tests.benchmarks.host._route_instances import Table, instance
from tests.benchmarks.host._route_outlines import faults
from tests.benchmarks.host.routes import held

from mdms_array.host import coordinator_of
from mdms_host.estimation.footprint import Disc, Rectangle
from mdms_host.routes.grid import Tiles
from mdms_host.routes.improving import legs_of
from mdms_host.routes.planner import Margins, Planner, SearchSettings
from mdms_host.routes.planning_problem import RouteTask
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.messages import End, Goal, decode_page
from mdms_sim.simulation import Simulation, addresses_of, open_bank

#: Of a way in each run: at least so many legs. The host is killed from the first plan on, up to so
#: much of the planned time [s].
LEAST, FIRST_S, SHARE = 4, 1.2, 0.8
#: A way of many legs has been given by then, or there is another one from where parcels are found.
GIVEN_S = 1.5
OUTCOMES = ("arrived", "beside", "blocked", "short", "failed", "waiting")
WITHIN_M, WITHIN_RAD, BESIDE_M, STEP_S = 0.005, 2.0 * pi / 180, 0.04, 0.05
#: All is over when nothing has moved for so long, or for less where all are at their goals.
STILL, STILL_S, ARRIVED_S = 2e-3, 18.0, 0.6
SPEED_M_S, LIMIT_S = 0.4, 90.0


@dataclass(frozen=True)
class CellsTable(Table):
    """A table whose ways are planned as for cells; `legs` is how many they may have."""

    legs: int = wire.LEGS_MAX
    clearance_m: float = 0.01

    @cached_property
    def planner(self) -> Planner:
        margins, search = Margins(self.clearance_m), SearchSettings(legs=self.legs)
        return Planner(Tiles(self.layout, 1), margins=margins, search=search)


TABLES = (CellsTable(9, 6, 3, 1), CellsTable(18, 10, 8, 1))
#: For runs: a parcel is found up to some 30 mm from where it lies, and is to have a way from there.
FOUND = CellsTable(9, 6, 3, 1, clearance_m=0.035)


def run() -> list[dict[str, Any]]:
    """Rows for the table of benchmarks."""
    instances = int(os.environ.get("MDMS_INSTANCES", "60"))
    first, cases = int(os.environ.get("MDMS_SEED", "1")), int(os.environ.get("MDMS_CASES", "2"))
    rows = [counted(table, range(first, first + instances)) for table in TABLES if instances]
    return [*rows, *([killed(FOUND, first, cases)] if cases else [])]


def counted(table: CellsTable, seeds: Sequence[int]) -> dict[str, Any]:
    """How many ways have more than seven legs, or six."""
    winding = CellsTable(table.columns, table.rows, table.parcels, 1, legs=2**31)
    legs: Counter[int] = Counter()
    before: Counter[int] = Counter()
    bad = 0
    for seed in seeds:
        tasks = instance(table, seed)
        plan = table.planner.plan(tasks)
        legs.update(map(legs_of, plan.routes.values()))
        before.update(map(legs_of, winding.planner.plan(tasks).routes.values()))
        bad += bool(faults(table.size_m, tasks, plan) or held(plan))
    ways = legs.total()
    return {
        "name": f"ways for cells, {table.parcels} on {table.name}: over seven legs",
        "ours": 100 * over(legs, 7) / ways,
        "peer": None,
        "ratio": None,
        "unit": "%",
        "before": 100 * over(before, 7) / ways,
        "over_six": 100 * over(legs, 6) / ways,
        "over_six_before": 100 * over(before, 6) / ways,
        "ways": ways,
        "most": max(legs),
        "bad": bad,
    }


def over(legs: Counter[int], most: int) -> int:
    return sum(ways for number, ways in legs.items() if number > most)


# The host is killed -----------------------------------------------------------------------------


@dataclass
class Given:
    """The places that the host has given to cells, by the parcel's identity, seen on the bus."""

    until_s: float
    places: dict[int, dict[int, tuple[int, int]]] = field(default_factory=dict)
    sequence: dict[int, int] = field(default_factory=dict)
    legs: dict[int, int] = field(default_factory=dict)
    most: int = 0

    def watch(self, frame: Frame, now_ns: int) -> None:
        """Take in a frame."""
        page = decode_page(frame.data) if frame.can_id == cob.PROGRAM else None
        if isinstance(page, End):
            self.places.pop(page.identity, None)
        if not isinstance(page, Goal) or now_ns > self.until_s * 1e9:
            return
        leg = page.leg if page.leg < wire.JOINS else 0
        if not leg and page.sequence != self.sequence.get(page.identity):
            # The rest of a way joins the given places; else none of them counts any more.
            old = self.places.get(page.identity, {})
            kept = {number - 1: place for number, place in old.items() if number > 1}
            self.places[page.identity] = kept if page.leg == wire.JOINS else {}
        self.sequence[page.identity], self.legs[page.identity] = page.sequence, page.legs
        self.most = max(self.most, page.legs + 1)
        self.places.setdefault(page.identity, {})[leg] = (page.x, page.y)

    def has_end(self, identity: int, goal: Sequence[float]) -> bool:
        """Whether the way that a parcel has leads to its goal."""
        x, y = self.places[identity].get(self.legs[identity], (0, 0))
        return hypot(x * 250e-6 - goal[0], y * 250e-6 - goal[1]) < 0.002


def killed(table: CellsTable, first: int, cases: int) -> dict[str, Any]:
    """Runs in which the host is killed on the way."""
    ended: Counter[str] = Counter()
    run = whole = 0
    for seed, tasks, end_s in winding(table, first):
        if run == cases:
            break
        gone_s = Random(f"legs {seed}").uniform(FIRST_S, FIRST_S + SHARE * end_s)
        outcomes = alone(tasks, seed, gone_s)
        if not outcomes:
            continue
        run += 1
        ended.update(outcomes.values())
        whole += {*outcomes.values()} <= {"arrived", "waiting"}
        print(f"  seed {seed}: host gone at {gone_s:.2f} s, {outcomes}", flush=True)
    given = ended.total() - ended["waiting"]
    return {
        "name": "ways of many legs, host killed on the way: arrived",
        "ours": 100 * ended["arrived"] / given,
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * at_least(ended["arrived"], given),
        **{name: ended[name] for name in OUTCOMES},
        "cases": run,
        "all_arrived": whole,
        "cases_bound": 100 * at_least(whole, run),
    }


def winding(table: CellsTable, first: int) -> Iterator[tuple[int, Sequence[RouteTask], float]]:
    """Instances in which a way is planned of many legs, and how long that takes [s]."""
    for seed in count(first):
        tasks = instance(table, seed)
        routes = table.planner.plan(tasks).routes.values()
        if max(map(legs_of, routes)) >= LEAST:
            yield seed, tasks, max(route.end_s for route in routes)


def alone(tasks: Sequence[RouteTask], seed: int, gone_s: float) -> Mapping[str, str]:
    """The outcome of each parcel when the host is killed at that time.

    Nothing, where none has been given a way of many legs by then: from where parcels are found,
    some mm beside, there may be another way, or none.
    """
    scenario = load_scenario(
        "swap2",
        [
            f"parcel=[{', '.join(map(parcel_text, tasks))}]",
            f"task=[{', '.join(map(task_text, range(len(tasks)), tasks))}]",
            "motion.control='cells'",
            "motion.go_on=true",
            f"motion.speed_m_s={SPEED_M_S}",
            "array.forwarded=[1, 2, 3, 4]",
            f"fault=[{{kind='host', start_s={gone_s:.3f}}}]",
            f"run.seed={seed}",
            f"run.duration_s={LIMIT_S}",
        ],
    )
    given = Given(gone_s)
    with closing(open_bank("cpython", addresses_of(scenario).node_ids)) as bank:
        simulation = Simulation(scenario, bank, [coordinator_of(scenario)])
        simulation.bus.observe(given.watch)
        time_s = still_s = 0.0
        ended: dict[str, str] = {}
        while time_s < LIMIT_S and still_s < STILL_S and not simulation.tipped:
            time_s += STEP_S
            simulation.run_until(time_s)
            if time_s > min(gone_s, GIVEN_S) and given.most < LEAST:
                return {}
            still = time_s > gone_s and abs(simulation.world.motion[1]).max() < STILL
            still_s = still_s + STEP_S if still else 0.0
            poses = simulation.world.motion[0]
            ended = {
                task.parcel: outcome(task, poses[index], index + 1, given)
                for index, task in enumerate(tasks)
            }
            if still_s >= ARRIVED_S and {*ended.values()} <= {"arrived", "waiting"}:
                break
        events = simulation.outcome().record.events
        touched = any(event.kind in ("touch", "tip") for event in events)
        harmed = simulation.tipped or touched or time_s >= LIMIT_S
    return dict.fromkeys(ended, "failed") if harmed else ended


def outcome(task: RouteTask, pose: Sequence[float], identity: int, given: Given) -> str:
    """The outcome of one parcel that stands."""
    assert task.goal is not None
    if identity not in given.places:
        return "waiting"
    period_rad = (
        task.shape.footprint.period_rad if isinstance(task.shape.footprint, Rectangle) else 1e-9
    )
    off_rad = abs(remainder(pose[2] - task.goal[2], period_rad))
    off_m = hypot(pose[0] - task.goal[0], pose[1] - task.goal[1])
    if off_m < WITHIN_M and off_rad < WITHIN_RAD:
        return "arrived"
    if off_m < BESIDE_M:
        return "beside"
    return "blocked" if given.has_end(identity, task.goal) else "short"


def parcel_text(task: RouteTask) -> str:
    """A parcel of a scenario."""
    footprint, (x_m, y_m, yaw_rad) = task.shape.footprint, task.start
    if isinstance(footprint, Disc):
        size = f"shape='disc', length_m={footprint.diameter_m}, width_m={footprint.diameter_m}"
    else:
        assert isinstance(footprint, Rectangle)
        size = f"length_m={footprint.length_m}, width_m={footprint.width_m}"
    return (
        f"{{name='{task.parcel}', mass_kg=2.0, {size}, "
        f"x_m={x_m:.4f}, y_m={y_m:.4f}, yaw_rad={yaw_rad:.4f}}}"
    )


def task_text(number: int, task: RouteTask) -> str:
    """The task of a parcel, beside the tasks before it."""
    assert task.goal is not None
    x_m, y_m, yaw_rad = task.goal
    turn = "" if isinstance(task.shape.footprint, Disc) else f", yaw_rad={yaw_rad:.4f}"
    beside = ", beside=true" if number else ""
    return f"{{do='transport', parcel='{task.parcel}', x_m={x_m:.4f}, y_m={y_m:.4f}{turn}{beside}}}"
