"""Fields of a scenario: what their keys may be together, and by which path a mistake is named."""

import tomllib

import pytest

from mdms_model.scenario.file import load_scenario, scenario_from
from mdms_model.scenario.motion import Part, Region
from mdms_model.scenario.scenario import ScenarioError

HEAD = """
title = "Fields"
[array]
columns = 6
rows = 3
[[cell.wheel]]
[[parcel]]
name = "box"
mass_kg = 2.0
length_m = 0.36
width_m = 0.30
[run]
fidelity = "ideal"
"""
GOAL = (
    HEAD.replace("0.30", "0.30\ngoal = { x_m = 0.1, y_m = 0.0 }").replace("ideal", "firmware")
    + '[motion]\nfield = "goal"'
)
SUM = """
[motion]
field = "sum"

[[motion.part]]
field = "uniform"
speed_m_s = 0.05
region = { shape = "rectangle", corners_m = [[-0.4, -0.2], [0.0, 0.2]] }

[[motion.part]]
field = "regions"

[[motion.part.part]]
field = "rotate"
speed_m_s = 0.1
region = { shape = "disc", centre_m = [0.1, 0.0], radius_m = 0.2 }

[[motion.part.part]]
field = "lane"
width_m = 0.2
"""


def read(motion):
    return scenario_from(tomllib.loads(HEAD + motion))


def test_a_composed_field_is_read_part_by_part():
    motion = read(SUM).motion
    assert motion.field == "sum"
    assert motion.part[0] == Part(
        "uniform",
        speed_m_s=0.05,
        region=Region("rectangle", corners_m=((-0.4, -0.2), (0.0, 0.2))),
    )
    assert motion.part[1].part[0].region == Region("disc", centre_m=(0.1, 0.0), radius_m=0.2)
    assert motion.part[1].part[1] == Part("lane", width_m=0.2)


def test_a_part_is_set_from_outside_by_its_number(tmp_path):
    file = tmp_path / "fields.toml"
    file.write_text(HEAD + SUM)
    scenario = load_scenario(file, ["motion.part.1.part.0.speed_m_s=0.3"])
    assert scenario.motion.part[1].part[0].speed_m_s == 0.3


def part(text):
    return f'[motion]\nfield = "sum"\n[[motion.part]]\n{text}'


RECTANGLE = 'field = "uniform"\nregion = { shape = "rectangle", '
POLYGON = 'field = "uniform"\nregion = { shape = "polygon", '


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ('[motion]\nfield = "sum"', r"motion.field is 'sum', but it has no parts.*motion.part"),
        (part("speed_m_s = 0.1"), r"motion.part.0.field is missing"),
        (part('field = "goal"'), r"motion.part.0.field is 'goal', but must be one of inward.*sum"),
        (part('field = "uniform"\nspeed = 1'), r"motion.part.0.speed is not .*mean speed_m_s"),
        (part('field = "lane"'), r"motion.part.0.field is 'lane', which needs .*0.width_m"),
        (
            '[motion]\nfield = "inward"\n[[motion.part]]\nfield = "uniform"',
            r"motion.part is given, but motion.field is 'inward'.*'sum' or 'regions'",
        ),
        (
            '[motion]\nfield = "regions"\n' + 2 * '[[motion.part]]\nfield = "uniform"\n',
            r"motion.part.0 has no region, so that no part after it ever holds",
        ),
        (
            part('field = "regions"\n[[motion.part.part]]\nfield = "sum"'),
            r"motion.part.0.part.0.field is 'sum', but it has no parts",
        ),
        (part(RECTANGLE + "corners_m = [[0, 0]] }"), r"0.region.corners_m must be two opposite"),
        (part(RECTANGLE + "corners_m = [[0, 0], [0, 1]] }"), r"must be two opposite corners"),
        (part(RECTANGLE + "radius_m = 1.0 }"), r"radius_m are for a disc, .* 'rectangle'"),
        (part('field = "uniform"\nregion = { shape = "disc" }'), r"region.radius_m is missing"),
        (
            part('field = "uniform"\nregion = { shape = "ring" }'),
            r"region.shape is 'ring', but must be one of rectangle, polygon, disc",
        ),
        (part(POLYGON + "corners_m = [[0, 0], [1, 0]] }"), r"three corners or more"),
        (
            part(POLYGON + "corners_m = [[0, 0], [1, 1], [1, 0], [0, 1]] }"),
            r"polygon whose sides do not cross; got \[\[0.0, 0.0\]",
        ),
        ('[motion]\npolicy = "slow"', r"motion.policy is 'slow', but must be one of rolling, "),
        ('[motion]\noutside = "drop"', r"motion.outside is 'drop', but must be one of refuse, "),
    ],
)
def test_a_mistake_is_named_by_its_path(motion, message):
    with pytest.raises(ScenarioError, match=message):
        read(motion)


@pytest.mark.parametrize(
    "key", ['policy = "rolling"', "compensate_droop = true", 'region = { shape = "disc" }']
)
def test_steering_to_goals_takes_no_key_of_open_loop_fields(key):
    with pytest.raises(ScenarioError, match=r"is for open-loop fields, but motion.field is 'goal'"):
        scenario_from(tomllib.loads(f"{GOAL}\n{key}"))


def test_policies_are_of_coulomb_friction():
    viscous = '[cell]\nviscous_friction_s_per_m = 0.5\n[motion]\npolicy = "sliding"'
    with pytest.raises(ScenarioError, match=r"Coulomb friction.*leave one out"):
        scenario_from(tomllib.loads(HEAD.replace("[[cell.wheel]]", "") + viscous))


def test_parts_within_parts_without_end_are_refused(tmp_path):
    tree = {"field": "uniform"}
    for _ in range(2000):
        tree = {"field": "sum", "part": [tree]}
    with pytest.raises(ScenarioError, match="nested too deeply"):
        scenario_from(tomllib.loads(HEAD) | {"motion": tree})
