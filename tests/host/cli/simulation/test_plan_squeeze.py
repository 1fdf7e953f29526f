"""`mdms plan-squeeze` plans, tries the plan on the array, and draws both."""

import json

import numpy as np
import pytest

from mdms_host.cli import main

TRIANGLE = "-0.2,-0.17 0.2,-0.17 0.02,0.19"
SLOW = ("--set", "motion.speed_m_s=0.05", "--time", "2")


def figures(capsys, *arguments):
    assert main(["plan-squeeze", "array18", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_triangle_is_oriented_in_three_squeezes(capsys):
    plan = figures(capsys, "--corners", TRIANGLE, "--poses", "0")
    headings = [step["heading_rad"] for step in plan["steps"]]
    np.testing.assert_allclose(np.degrees(headings), [0.0, 145.56, 178.0], atol=0.1)
    assert [len(step["yaws_rad"]) for step in plan["steps"]] == [3, 2, 1]
    assert plan["steps"][0]["margin_rad"] is None
    assert plan["margin_rad"] == pytest.approx(np.radians(20.5), abs=0.01)
    assert plan["period_rad"] == pytest.approx(np.pi)
    assert plan["trials"] is None


def test_a_long_rectangle_of_the_scenario_needs_one_and_its_nearly_square_box_two(capsys):
    plan = figures(capsys, "--poses", "0", "--set", "parcel.0.width_m=0.2")
    assert len(plan["steps"]) == 1
    assert plan["alike_in_a_turn"] == 2
    assert plan["yaw_rad"] == pytest.approx(0.0, abs=1e-9)
    plan = figures(capsys, "--poses", "0")
    yaws = np.degrees(plan["steps"][0]["yaws_rad"])
    np.testing.assert_allclose(yaws, [16.1, 163.9], atol=0.1)
    assert len(plan["steps"]) == 2


def test_a_wanted_yaw_is_where_it_ends(capsys):
    plan = figures(capsys, "--poses", "0", "--yaw", "0.6", "--set", "parcel.0.width_m=0.2")
    assert plan["yaw_rad"] == pytest.approx(0.6)
    assert plan["steps"][0]["heading_rad"] == pytest.approx(0.6)


@pytest.mark.compiles
def test_trials_are_counted_step_by_step_and_are_the_seeds(capsys):
    arguments = ("--corners", TRIANGLE, "--poses", "5", *SLOW)
    first = figures(capsys, *arguments)
    trials = first["trials"]
    assert trials["count"] == 5
    assert len(trials["steps"]) == 3
    for step in trials["steps"]:
        assert sum(value for name, value in step.items() if name != "within") == 5
    assert set(trials["within"]) == {"2", "5", "10", "20"}
    assert figures(capsys, *arguments) == first
    assert figures(capsys, *arguments, "--seed", "2") != first


def test_people_read_the_plan_and_its_result(capsys, tmp_path):
    picture = tmp_path / "plan.png"
    arguments = ["--corners", TRIANGLE, "--poses", "3", *SLOW, "--out", str(picture)]
    assert main(["plan-squeeze", "array18", *arguments]) == 0
    said = capsys.readouterr().out
    assert "from any angle to yaw 99.0° in 3 squeezes" in said
    assert "yaws are known up to 180°" in said
    assert "2. onto a line along 145.6°: yaw 66.6° or 103.5°, 20.5° to spare" in said
    assert "simulated from 3 random poses" in said
    assert "step 3, beside the field without gaps: " in said
    assert f"picture: {picture}" in said
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_square_is_oriented_up_to_its_quarter_turn_and_that_is_said(capsys):
    square = "-0.15,-0.15 0.15,-0.15 0.15,0.15 -0.15,0.15"
    assert main(["plan-squeeze", "array18", "--corners", square, "--poses", "0"]) == 0
    said = capsys.readouterr().out
    assert "known up to 90°" in said
    assert "the polygon looks the same 4 times in a turn" in said


def test_a_plan_that_turns_no_parcel_fails(capsys):
    small = ["--corners", "0,0 0.16,0 0,0.16", "--poses", "3"]
    assert main(["plan-squeeze", "array18", *small]) == 1
    printed = capsys.readouterr()
    assert "simulated from 3 random poses: 0% within 2" in printed.out
    assert "in none of 3 trials the parcel came within 20 degrees of its yaw, and 2" in printed.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--corners", "0,0 1,0"], "is not three corners X,Y or more"),
        (
            ["--corners", "0,0 1,0 x,1"],
            "is not three corners X,Y or more with spaces between, as in '0,0 0.3,0",
        ),
        (["--corners", "a,b"], "'a,b' is not three corners X,Y or more"),
        (["--yaw", "east"], "east is not within 6.2832 rad, as in 0.5"),
        (["--time", "long"], "long is not above 0 s, as in 30"),
        (["--corners", "0,0 0,1 1,0"], "--corners: corners_m of parcel 'box' must be at least"),
        (["--corners", "0,0 1,0 1,1 0.9,0.1"], "convex polygon, counter-clockwise"),
        (["--corners", TRIANGLE, "--parcel", "ball"], "--parcel ball: no such parcel"),
        (["--poses", "-1"], "is not 0 to"),
        (["--set", "motion.speed_m_s=0"], "motion.speed_m_s is 0, and nothing would move"),
        (["--set", "parcel.0.shape=disc", "--set", "parcel.0.width_m=0.36"], "is a disc, which no"),
        (["--corners", "0,0 0.02,0 0,0.02"], "tips wherever it lies on this array"),
        (["--set", "motion.policy=sliding", "--set", "motion.speed_m_s=0.01"], "(eq 15)"),
    ],
)
def test_bad_input_ends_with_exit_2_and_a_reason(capsys, arguments, message):
    try:
        code = main(["plan-squeeze", "array18", *arguments])
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert message in capsys.readouterr().err
