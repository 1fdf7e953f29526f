"""`mdms map` draws a field and reports where it holds a parcel."""

import json

import pytest

from mdms_host.cli import main


@pytest.fixture
def picture(tmp_path):
    return tmp_path / "map.png"


def figures(capsys, picture, *arguments):
    assert main(["map", *arguments, "--json", "--out", str(picture)]) == 0
    return json.loads(capsys.readouterr().out)


def test_inward_field_holds_the_papers_parcel_in_the_middle(capsys, picture):
    told = figures(capsys, picture, "paper-fig8")
    (place,) = told["places"]
    assert place["kind"] == "stable"
    assert place["x_m"] == pytest.approx(0.0, abs=1e-9)
    assert place["stiffness_n_per_m"][0] < 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_law_of_the_wheels_can_be_chosen(capsys, picture):
    arguments = ("paper-fig7", "--law", "at_rest")
    assert figures(capsys, picture, *arguments)["law"] == "at_rest"


def test_turns_are_told_for_people_with_the_picture(capsys, picture):
    assert main(["map", "array18", "--set", "motion.field=inward", "--out", str(picture)]) == 0
    told = capsys.readouterr().out
    assert "inward field on box" in told
    assert "unstable at yaw" in told
    assert f"picture: {picture}" in told


def test_scenario_of_goals_is_mapped_with_a_field_that_is_named(capsys, picture):
    assert main(["map", "array18", "--out", str(picture)]) == 0
    told = capsys.readouterr()
    assert "motion.field is 'goal', which is no field to draw; 'inward' is drawn" in told.err
    assert "inward field on box" in told.out
    assert picture.exists()


def test_unknown_parcel_is_refused_with_the_known_ones(capsys, picture):
    assert main(["map", "paper-fig8", "--parcel", "ball", "--out", str(picture)]) == 2
    assert capsys.readouterr().err == "mdms: --parcel ball: no such parcel; there are box\n"


def test_map_into_nowhere_is_refused_in_one_line(capsys, tmp_path):
    picture = tmp_path / "none" / "map.png"
    assert main(["map", "array18", "--out", str(picture)]) == 2
    told = f"mdms: {picture}: cannot be written: No such file or directory\n"
    assert capsys.readouterr().err == told
