"""A parcel that the host was not told of is found, kept clear of, and reported; none touches it."""

import numpy as np
import pytest

import mdms_array as mdms
from mdms_host.estimation.footprint import Rectangle, gap_m
from mdms_host.programs.script import until
from mdms_model.scenario.file import load_scenario, scenario_from

TABLE = {
    "title": "A box on its way, and a crate in it that nobody spoke of",
    "array": {"columns": 9, "rows": 3},
    "cell": {
        "rotor_inertia_kg_m2": 5e-6,
        "wheel": [
            {"offset_m": [-0.03, 0.0]},
            {"direction_rad": np.pi / 2, "offset_m": [0.03, 0.0]},
        ],
    },
    "motion": {"field": "goal", "speed_m_s": 0.15},
    "belief": {"crate": {"known": False}},
}
BOX = {
    "name": "box",
    "mass_kg": 1.5,
    "length_m": 0.28,
    "width_m": 0.26,
    "x_m": -0.38,
    "goal": {"x_m": 0.35, "y_m": 0.0},
}
CRATE = {"name": "crate", "mass_kg": 1.0, "length_m": 0.26, "width_m": 0.28, "yaw_rad": 0.3}


def run(duration_s: float, crate: dict, fault: list = ()):
    scenario = scenario_from(
        TABLE
        | {
            "run": {"fidelity": "firmware", "duration_s": duration_s},
            "parcel": [BOX, CRATE | crate],
            "fault": list(fault),
        }
    )
    return mdms.simulate(scenario)


def times_of(run: mdms.Run, text: str) -> list[float]:
    return [event.time_s for event in run.events if text in event.detail]


def gaps_m(record) -> np.ndarray:
    box = Rectangle(BOX["length_m"], BOX["width_m"])
    crate = Rectangle(CRATE["length_m"], CRATE["width_m"])
    there = np.isfinite(record.pose[:, 1, 0])
    return np.array([gap_m(box, pose[0], crate, pose[1]) for pose in record.pose[there]])


@pytest.fixture(scope="module")
def blocked():
    return run(6.0, {"x_m": 0.1, "y_m": 0.02})


def test_an_unknown_thing_is_found_at_its_place(blocked):
    (found_s,) = times_of(blocked, "unknown-1 appeared at x = 0.0")
    (box_s,) = times_of(blocked, "box found")
    assert found_s < box_s + 0.3


def test_a_box_waits_before_it_and_touches_nothing(blocked):
    (waits,) = (event.detail for event in blocked.events if "box waits, for 60 s" in event.detail)
    assert "blocked by 'unknown-1' at its place" in waits
    record = blocked.record
    assert gaps_m(record).min() > 0.005
    assert np.abs(record.pose[-1, 1] - record.pose[0, 1]).max() < 1e-4
    late = record.time_s > 5.5
    assert np.abs(record.speed_m_s[late]).max() < 2e-3
    assert record.pose[-1, 0, 0] > record.pose[0, 0, 0] + 0.05


def test_wheels_under_it_stand(blocked):
    record = blocked.record
    wheels_m = np.array([0.127 * (np.arange(27) % 9 - 4), 0.127 * (np.arange(27) // 9 - 1)]).T
    under = np.hypot(*(wheels_m - (0.1, 0.02)).T) < 0.1
    assert np.abs(record.reference_m_s.reshape(-1, 27, 2)[:, under]).max() == 0.0


def test_a_run_that_waits_to_its_end_has_not_reached_its_goal(blocked):
    (goal,) = blocked.figures["goals"]
    assert not goal["reached"]


def test_a_crate_that_looks_like_the_box_is_not_taken_for_it():
    """It covers more sensors than the box, but lies elsewhere than the host was told."""
    alike = {"length_m": 0.30, "width_m": 0.28, "yaw_rad": 0.0, "x_m": 0.25, "y_m": 0.0}
    ended = run(2.0, alike)
    (found,) = [event.detail for event in ended.events if event.detail.startswith("box found")]
    assert "x = -0.3" in found
    assert not ended.violations


@pytest.mark.parametrize("told", [{"x_m": 0.2}, {"x_m": 0.3, "y_m": 0.05}, {"yaw_rad": 0.3}])
def test_a_lone_box_is_found_wherever_it_lies(told):
    over = [f"belief.box.{key}={value}" for key, value in told.items()]
    ended = mdms.simulate(load_scenario("array18", over))
    assert ended.status == "reached"


def test_a_box_goes_on_once_the_crate_is_lifted_away():
    lift = {"kind": "lift", "parcel": "crate", "start_s": 3.5}
    ended = run(9.0, {"x_m": 0.1, "y_m": 0.02}, [lift])
    assert 3.5 < times_of(ended, "unknown-1 is not there any more")[0] < 3.75
    (goal,) = ended.figures["goals"]
    assert goal["reached"]


def test_a_crate_that_is_set_down_before_a_moving_box_stops_it():
    lift = {"kind": "lift", "parcel": "crate", "start_s": 0.0, "duration_s": 2.0}
    there = {"x_m": 0.22, "y_m": 0.0, "yaw_rad": 0.2}
    ended = run(5.0, {"x_m": 0.4, "y_m": 0.0}, [lift | there])
    (found_s,) = times_of(ended, "unknown-1 appeared at x = 0.2")
    assert 2.0 < found_s < 2.3
    after = ended.record.time_s > 2.1
    assert gaps_m(ended.record)[-after.sum() :].min() > 0.0


def test_a_program_may_name_a_thing_anew_that_has_not_the_outline_it_was_given():
    said = []

    async def main(table):
        await until(lambda: table.unknown_at(0.2, 0.0) is not None)
        try:
            await table.name(mdms.Newcomer("plank", 0.5, 0.1), 0.2, 0.0)
        except mdms.ProgramError as error:
            said.append(str(error))
        await table.name(mdms.Newcomer("crate", 0.26, 0.28), 0.2, 0.0)

    boxes = [{key: BOX[key] for key in BOX if key != "goal"}, CRATE | {"x_m": 0.2, "yaw_rad": 0.0}]
    job = {
        "parcel": boxes,
        "motion": {"field": "program", "speed_m_s": 0.15},
        "task": [{"do": "wait", "period_s": 1.0}],
        "run": {"fidelity": "firmware", "duration_s": 8.0},
    }
    run = mdms.simulate(scenario_from(TABLE | job), program=main)
    assert (run.status, run.reason) == ("reached", "")
    assert said == ["unknown-1 has not the outline of plank"]
