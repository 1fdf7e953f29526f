"""The routes of parcels, and the reasons for a missing route."""

import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.host.routes.parcels import LONG, task

from mdms_array.host import layout_of
from mdms_host.estimation.footprint import Rectangle
from mdms_host.layout import Layout
from mdms_host.routes import planner as planner_module
from mdms_host.routes.grid import Tiles
from mdms_host.routes.planner import Margins, Planner, planner_compiled_beside
from mdms_host.routes.support import Shape, ShapeSupport
from mdms_model.scenario.file import load_scenario


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(Tiles(Layout(9, 6)))


def test_a_parcel_alone_goes_straight_and_turns_on_its_way(planner: Planner) -> None:
    plan = planner.plan([task("a", (-0.35, -0.15, 0.0), (0.3, 0.1, 1.5), LONG)], now_s=5.0)
    route = plan.routes["a"]
    assert np.allclose(route.poses, [[-0.35, -0.15, 0.0], [0.3, 0.1, 1.5]])
    assert route.begins_s[0] == 5.0
    assert plan.reservations.limits_m({"a": 0.0}) == {"a": route.length_m}


def test_two_parcels_that_change_sides_wait_for_each_other(planner: Planner) -> None:
    tasks = [
        task("a", (-0.4, 0.2, 0.0), (0.4, 0.2, 0.0)),
        task("b", (0.4, 0.15, 0.0), (-0.4, -0.2, 0.0)),
    ]
    plan = planner.plan(tasks)
    assert not plan.blocked
    assert all(np.allclose(plan.routes[t.parcel].poses[-1], t.goal) for t in tasks)
    first, second = plan.order
    limits_m = plan.reservations.limits_m({"a": 0.0, "b": 0.0})
    assert limits_m[first] > 0.0
    assert limits_m[second] < plan.routes[second].length_m
    done_m = {first: plan.routes[first].length_m, second: 0.0}
    assert plan.reservations.limits_m(done_m)[second] == plan.routes[second].length_m


def test_parcels_in_one_row_that_cannot_pass_are_refused_by_name() -> None:
    planner = Planner(Tiles(Layout(9, 3)))
    tasks = [
        task("a", (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0)),
        task("b", (0.4, 0.0, 0.0), (-0.4, 0.0, 0.0)),
    ]
    plan = planner.plan(tasks)
    assert set(plan.blocked) == {"a", "b"}
    assert "'a' has no way" in str(plan.blocked["a"])
    assert "blocked by 'b' at its place" in str(plan.blocked["a"])
    assert len(plan.routes["a"].poses) == 1


def test_a_goal_beyond_the_edge_is_refused(planner: Planner) -> None:
    plan = planner.plan([task("a", (0.0, 0.0, 0.0), (0.0, 0.6, 0.0))])
    assert "on this table" in str(plan.blocked["a"])


def test_a_goal_at_which_a_corner_hangs_over_the_edge_is_reached_if_it_stands_there() -> None:
    """The demo's box on 6 x 3 cells: turned by 30 degrees it hangs over by 30 mm."""
    planner = Planner(Tiles(Layout(6, 3)))
    plan = planner.plan([task("a", (-0.1, 0.0, 0.0), (0.1, 0.0, 0.5236), LONG)])
    assert np.allclose(plan.routes["a"].poses[-1], [0.1, 0.0, 0.5236])
    # Beyond the rim of tiles, 50 mm less the clearance, nothing keeps others apart from it.
    over_far = planner.plan([task("a", (-0.1, 0.0, 0.0), (0.1, 0.09, 0.0), LONG)])
    assert "hang over the edge" in str(over_far.blocked["a"])


def test_ways_hang_over_the_edge_as_far_as_the_rim_of_tiles_where_they_may() -> None:
    layout = Layout(6, 3)
    wide, usual = Planner(Tiles(layout, rim_m=0.15), hangs=True), Planner(Tiles(layout))
    # At the goal by 50 mm; in the middle of half a turn whose ends are on the table, by 60 mm.
    ways = [((-0.1, 0.0, 0.0), (0.1, 0.09, 0.0)), ((0.0, 0.0, 0.0), (0.0, 0.0, 3.1))]
    for way in ways:
        task_ = task("a", *way, LONG)
        assert "hang over the edge" in str(usual.plan([task_]).blocked["a"])
        plan = wide.plan([task_])
        assert np.allclose(plan.routes["a"].poses[-1], way[1])
        # The tiles under all of it are the parcel's own.
        under = wide.stand(task_.shape, plan.routes["a"].poses[-1])
        assert set(under) <= set(plan.routes["a"].visits.tile)
    beyond = wide.plan([task("a", (-0.1, 0.0, 0.0), (0.1, 0.2, 0.0), LONG)])
    assert "hang over the edge" in str(beyond.blocked["a"])


def test_a_way_on_which_a_parcel_tips_beside_it_is_taken_only_where_there_is_no_other() -> None:
    layout, box = layout_of(load_scenario("array18")), Shape(Rectangle(0.282, 0.222))
    beside = ShapeSupport(layout, box, 0.006)
    # On its straight way it comes to lie along a row of cells, amid two of them.
    ends = (0.101, -0.041, 1.125), (0.002, -0.005, -0.777)
    tiles = Tiles(layout, rim_m=0.15)
    usual = Planner(tiles, hangs=True)
    careful = Planner(tiles, margins=Margins(off_m=0.006), hangs=True)
    straight = usual.plan([task("a", *ends, box)]).routes["a"].poses
    assert len(straight) == 2
    assert not beside.stands(*straight)
    poses = careful.plan([task("a", *ends, box)]).routes["a"].poses
    assert np.allclose(poses[-1], ends[1])
    assert all(beside.stands(*way) for way in pairwise(poses))
    # A goal where it tips so far beside is no reason to stay.
    unsure = np.array([0.0, 0.0, 0.2])
    assert not beside.stands(unsure, unsure)
    plan = careful.plan([task("a", ends[0], tuple(unsure), box)])
    assert np.allclose(plan.routes["a"].poses[-1], unsure)


def test_two_parcels_change_places_when_one_stands_aside(planner: Planner) -> None:
    tasks = [
        task("a", (-0.35, 0.2, 0.0), (0.35, 0.2, 0.0)),
        task("b", (0.35, 0.2, 0.0), (-0.35, 0.2, 0.0)),
    ]
    plan = planner.plan(tasks)
    assert not plan.blocked
    assert all(np.allclose(plan.routes[t.parcel].poses[-1], t.goal) for t in tasks)


def test_two_parcels_change_places_when_both_stand_aside(planner: Planner) -> None:
    tasks = [
        task("a", (-0.3, 0.0, 0.0), (0.3, 0.0, 0.0)),
        task("b", (0.3, 0.0, 0.0), (-0.3, 0.0, 0.0)),
    ]
    plan = planner.plan(tasks)
    assert not plan.blocked
    assert all(np.allclose(plan.routes[t.parcel].poses[-1], t.goal) for t in tasks)


def test_a_goal_that_cannot_be_reached_leaves_others_their_ways() -> None:
    planner = Planner(Tiles(Layout(15, 3)))
    free = task("free", (-0.75, 0.0, 0.0), (-0.7, 0.0, 0.0))
    behind = task("behind", (-0.3, 0.0, 0.0), (0.05, 0.0, 0.0))
    lost = task("lost", (0.1, 0.0, 0.0), (0.95, 0.0, 0.0))
    plan = planner.plan([free, behind, lost])
    assert set(plan.blocked) == {"behind", "lost"}
    assert np.allclose(plan.routes["free"].poses[-1], free.goal)
    assert [blocker.parcel for blocker in plan.blocked["behind"].by] == ["lost"]
    assert not plan.blocked["lost"].by


COMPILED_LATER = """
import sys
from mdms_array.simulation import run_scenario
from mdms_host.routes.planner import compile_planner
from mdms_model.scenario.file import load_scenario

def known():
    routes = [module for name, module in sys.modules.items() if name.startswith("mdms_host.routes")]
    functions = [each for module in routes for each in vars(module).values()]
    return {
        (each.__qualname__, signature)
        for each in functions if hasattr(each, "signatures") for signature in each.signatures
    }

compile_planner()
before = known()
run_scenario(load_scenario("array18", ["run.duration_s=1"]))
print(len(before), *(name for name, _ in known() - before))
"""


def test_what_is_compiled_beside_a_run_is_all_that_its_planner_needs() -> None:
    done = subprocess.run(
        [sys.executable, "-c", COMPILED_LATER], capture_output=True, text=True, check=True
    )
    count, *later = done.stdout.split()
    assert int(count) > 10
    assert not later


Companions = list[subprocess.Popen[bytes]]


@pytest.fixture
def companions(monkeypatch: pytest.MonkeyPatch) -> Companions:
    """The processes that are started to compile."""
    started: Companions = []

    def start(command: list[str], **streams: int) -> subprocess.Popen[bytes]:
        started.append(subprocess.Popen(command, **streams))  # type: ignore[call-overload]
        return started[-1]

    monkeypatch.setattr(planner_module, "Popen", start)
    return started


def test_the_process_that_compiles_beside_a_run_plans_wherever_it_is_started(
    companions: Companions, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(planner_module, "is_kept", lambda module: False)
    (tmp_path / "random.py").write_text("raise SystemExit('this is no module of Python')")
    monkeypatch.chdir(tmp_path)
    with planner_compiled_beside():
        (companion,) = companions
        assert companion.wait(300) == 0


def test_the_process_that_compiles_beside_a_run_ends_with_it(
    companions: Companions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planner_module, "is_kept", lambda module: False)
    with planner_compiled_beside():
        (companion,) = companions
    assert companion.poll() is not None


def test_no_process_compiles_what_is_on_disk(
    companions: Companions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planner_module, "is_kept", lambda module: True)
    with planner_compiled_beside():
        assert not companions
