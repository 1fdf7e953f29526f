"""The figures of a run about its parcels."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tests.storms
from tests.storms.storm import load, scenario_of

from mdms_array.figures import TWIST, believed_run, raise_for_end, report, simulated_run
from mdms_array.host import coordinator_of
from mdms_array.run import TimeLimitError
from mdms_array.simulation import host_report_of
from mdms_host.cli.live_array import Verdict
from mdms_host.programs.table_orders import LineOrder
from mdms_host.programs.traffic.world_state import WorldState
from mdms_model.run.record import Record
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import simulate

TIME_S = np.linspace(0.0, 2.0, 201)


def figures(scenario, x_m, estimate=None, **times_s):
    pose = np.zeros((len(TIME_S), 1, 3))
    pose[:, 0, 0] = x_m
    wheels = np.zeros((len(TIME_S), 10))
    twist = np.gradient(pose, TIME_S, axis=0)
    codes = wheels.astype(np.int8)
    record = Record(TIME_S, pose, twist, *[wheels] * 5, codes, estimate)
    return simulated_run(scenario, record, **times_s).figures


@pytest.fixture
def scenario():
    return load_scenario("paper-fig7")


def parcel_of(scenario, x_m, estimate=None):
    return figures(scenario, x_m, estimate)["parcels"][0]


def test_parcel_at_a_turning_point_is_not_at_rest(scenario):
    swinging = 0.1 * np.cos(np.pi * TIME_S)
    parcel = parcel_of(scenario, swinging)
    assert abs(parcel["vx_m_s"]) < 0.01
    assert parcel["at_rest"] is False


def test_parcel_that_has_stood_a_while_is_at_rest(scenario):
    assert parcel_of(scenario, np.minimum(TIME_S, 1.0))["at_rest"] is True


def test_real_time_factor_is_simulated_over_wall_time(scenario):
    assert figures(scenario, 0.0, wall_s=0.5)["real_time_factor"] == 4.0


def test_estimate_is_told_only_where_there_is_one(scenario):
    belief = np.full((len(TIME_S), 1, 3), np.nan)
    assert "estimate" not in parcel_of(scenario, 0.0, estimate=belief)
    belief[-1] = (0.1, 0.2, 0.3)
    told = parcel_of(scenario, 0.0, estimate=belief)["estimate"]
    assert told == {"x_m": 0.1, "y_m": 0.2, "yaw_rad": 0.3}


def test_report_has_a_line_per_parcel(scenario):
    lines = report(figures(scenario, 0.25))
    assert "20" not in lines[1]
    assert lines[2].strip() == "box: x +0.2500 m, y +0.0000 m, yaw +0.0 deg, at rest"


@pytest.mark.parametrize(
    ("twist", "told"),
    [
        ((0.0, 0.0, 0.0), "standing, for less than 0.5 s"),
        ((0.0, 0.0, -0.1), "turning at -5.7 deg/s"),
        ((0.03, 0.04, 0.0), "moving at 0.050 m/s"),
    ],
)
def test_report_says_what_a_parcel_does_that_is_not_at_rest(scenario, twist, told):
    run = figures(scenario, 0.25)
    (parcel,) = run["parcels"]
    parcel |= {"at_rest": False, **dict(zip(TWIST, twist, strict=True))}
    assert report(run)[2].endswith(f", {told}")


def test_that_compiling_happens_once_is_not_said_twice(scenario):
    """The notice said it, when compiling began."""
    assert "  after 20.0 s of compiling" in report(figures(scenario, 0.0, compile_s=20.0))


def test_a_run_has_not_reached_a_goal_where_nobody_knows_that_the_parcel_is_there(monkeypatch):
    """On a table there is no truth to judge by."""
    # No edge has shown where a box is along x, and it cannot be shifted to be felt.
    monkeypatch.setattr(WorldState, "has_room", lambda *_: False)
    name = "what-no-edge-has-shown-well-enough-has-not-arrived.toml"
    scenario = scenario_of(load((Path(tests.storms.__file__).parent / "found" / name).read_text()))
    coordinator = coordinator_of(scenario)
    ended = simulate(
        scenario, [coordinator], "cpython", host_report=lambda: host_report_of(coordinator)
    )
    assert coordinator.finished
    assert list(coordinator.arrived) == ["parcel 1"]
    run = believed_run(scenario, ended.record, coordinator, fault=None)
    assert run.status == "time limit"
    assert run.reason.startswith(
        "goal not reached: parcel 2 may be beside its goal: it is known to"
    )
    assert {goal["parcel"]: goal["reached"] for goal in run.figures["goals"]} == {
        "parcel 1": True,
        "parcel 2": False,
    }
    assert run.reason in ("goal not reached: " + incident.text for incident in run.incidents)
    with pytest.raises(TimeLimitError, match="parcel 2 may be beside its goal"):
        raise_for_end(scenario, coordinator, late=False)


def test_a_program_that_ends_before_its_parcel_is_there_has_not_reached_a_goal_on_a_table_either():
    async def main(table):
        table.start(table["box"].move(0.1, 0.0))

    scenario = load_scenario("array18")
    coordinator = coordinator_of(scenario, main=main)
    ended = simulate(scenario, [coordinator], "cpython", over=lambda: coordinator.finished)
    run = believed_run(scenario, ended.record, coordinator, fault=None)
    assert run.status == "time limit"
    assert run.reason.startswith("goal not reached: box is 195")
    with pytest.raises(TimeLimitError, match="goal not reached: box is 195"):
        raise_for_end(scenario, coordinator, late=False)


def test_a_program_is_not_judged_while_an_order_of_the_plant_is_under_way():
    async def main(_table):
        pass

    scenario = load_scenario("array18")
    coordinator = coordinator_of(scenario, main=main)
    program, orders = coordinator.program, coordinator.program.table.orders
    program.serve_orders()
    orders.give(LineOrder("1", "box", x_m=0.1, y_m=0.0))
    jobs = {"": (SimpleNamespace(scenario=scenario), None)}
    slot, table = SimpleNamespace(coordinator=coordinator), SimpleNamespace(taken_over=None)
    verdict = Verdict(slot, table, SimpleNamespace(jobs=jobs, running=""))
    simulate(
        scenario, [coordinator], "cpython", over=lambda: verdict.look() or orders.is_any_under_way
    )
    assert orders.is_any_under_way
    verdict.look()
    verdict.raise_error()
