"""Scenario files are read, changed by overrides, and refused by the key's full path."""

import json
import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.scenario.file import builtin_names, load_scenario, scenario_from
from mdms_model.scenario.scenario import Goal, Scenario, ScenarioError
from mdms_model.scenario.tree import plain, spell_out

ROW = """
title = "a row"
[array]
columns = 10
rows = 1
[[parcel]]
name = "box"
mass_kg = 2
length_m = 0.4445
width_m = 0.1
x_m = -0.3
[motion]
speed_m_s = 0.0635
"""


@pytest.fixture
def row(tmp_path):
    path = tmp_path / "row.toml"
    path.write_text(ROW)
    return path


def refusal(path, *overrides):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path, overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_whole_number_serves_as_a_number(row):
    mass_kg = load_scenario(row).parcel[0].mass_kg
    assert mass_kg == 2.0
    assert isinstance(mass_kg, float)


def test_silent_keys_take_their_defaults(row):
    scenario = load_scenario(row)
    assert scenario.cell.gain_vs_per_m == 10.0
    assert scenario.array.pitch_m == 0.127
    assert scenario.parcel[0].goal is None


@pytest.mark.parametrize("name", builtin_names())
def test_builtin_scenario_survives_a_round_trip(name):
    scenario = load_scenario(name)
    assert scenario_from(json.loads(json.dumps(plain(scenario)))) == scenario


def test_the_papers_figures_and_the_prototype_are_built_in():
    assert {"array18", "paper-fig7", "paper-fig8", "paper-fig9"} <= set(builtin_names())


def test_override_reaches_into_lists_by_number(row):
    scenario = load_scenario(row, ["parcel.0.x_m=-0.25", "cell.wheel.0.offset_m.1=0.01"])
    assert scenario.parcel[0].x_m == -0.25
    assert scenario.cell.wheel[0].offset_m == (0.0, 0.01)


def test_override_takes_bare_text_and_toml(row):
    scenario = load_scenario(
        row,
        [
            "title=two words",
            "run.fidelity=firmware",
            'motion.field="goal"',
            "parcel.0.goal={x_m=0.1, y_m=0}",
        ],
    )
    assert scenario.title == "two words"
    assert scenario.parcel[0].goal == Goal(0.1, 0.0)


def test_override_makes_a_table_that_was_not_there(row):
    scenario = load_scenario(row, ["parcel.0.goal.x_m=0.1", "parcel.0.goal.y_m=0"])
    assert scenario.parcel[0].goal == Goal(0.1, 0.0)


def test_later_override_wins(row):
    assert load_scenario(row, ["run.seed=2", "run.seed=3"]).run.seed == 3


def test_override_may_mend_a_file(row):
    row.write_text(ROW.replace("mass_kg = 2", "mass_kg = -2"))
    assert load_scenario(row, ["parcel.0.mass_kg=2"]).parcel[0].mass_kg == 2.0


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("parcel.0.mass_kg=-2", "parcel.0.mass_kg is -2, but must be above 0"),
        ("parcel.0.mass_kg=0", "parcel.0.mass_kg is 0, but must be above 0"),
        ("parcel.0.mass_kg=heavy", "parcel.0.mass_kg is 'heavy', but must be a number"),
        ("parcel.0.mass_kg=nan", "parcel.0.mass_kg is nan, but must be a finite number"),
        ("parcel.0.mass_kg=1e999", "parcel.0.mass_kg is inf, but must be a finite number"),
        ("parcel.0.mass_kg=" + "9" * 400, "but must be a finite number"),
        ("parcel.0.mass_kg=true", "parcel.0.mass_kg is True, but must be a number"),
        ("parcel.0.masskg=1", "parcel.0.masskg is not a known key; did you mean mass_kg?"),
        ("parcel.0.colour=1", "known here: name, mass_kg"),
        ("parcel.1.mass_kg=1", "parcel.1: there is no such item; number parcel from 0 to 0"),
        ("parcel.0.x_m=5", "parcel.0.x_m is 5.0, which puts the centre of mass of 'box' off"),
        ("parcel.0.y_m=-0.07", "parcel.0.y_m is -0.07"),
        ("parcel.0.centre_of_mass_m=[1, 0]", "parcel.0.centre_of_mass_m is [1.0, 0.0]"),
        ("parcel.0.goal.x_m=0.1", "parcel.0.goal.y_m is missing; give it a number"),
        ("parcel.0.name=", "parcel.0.name is ''"),
        ("parcel=[]", "parcel is missing, which run.fidelity 'row' needs"),
        ("array.columns=0", "array.columns is 0, but must be at least 1"),
        ("array.columns=2.5", "array.columns is 2.5, but must be a whole number"),
        ("array=3", "array is 3, but must be a table"),
        ("cell.wheel.0.offset_m=[1]", "cell.wheel.0.offset_m has 1 items, but must have 2"),
        ("cell.wheel.0.offset_m.1=inf", "cell.wheel.0.offset_m.1 is inf"),
        ("motion.field=sideways", "motion.field is 'sideways', but must be one of inward"),
        ("motion.field=goal", "but no parcel has a goal"),
        ("run.fidelity=exact", "must be one of row, ideal, firmware"),
        ("run.step_s=1e-12", "take a longer step"),
        ("run.duration_s=1e5", "make the run shorter or the array smaller"),
        ("parcel.0.shape=disc", "parcel.0: length_m and width_m of parcel 'box'"),
        ("parcel.0.shape=polygon", "parcel.0: corners_m of parcel 'box' must be at least three"),
        ("parcel.0.corners_m=[[0, 0]]", "parcel.0.corners_m is given, but parcel.0.shape is"),
        ("patch=[{cells=[11]}]", "patch.0.cells has 11, but the array has 10 cells"),
        ("patch=[{cells=[0]}]", "patch.0.cells.0 is 0, but must be at least 1"),
        ("patch=[{cells=[1], friction=0.1}]", "patch.0 makes cells unlike the rest"),
        ("run.seed=-1", "run.seed is -1, but must be at least 0"),
        ("array.rows=2", "run.fidelity is 'row', which needs array.rows = 1"),
        ('title="two\\nlines"', "but must be one line of plain text"),
        ("scenario=paper-fig8", "scenario is 'paper-fig8', but no key changes which scenario"),
        ("title.x=3", "title is 'a row' and has nothing inside to set"),
        ("=3", "write KEY=VALUE"),
        ("run.seed", "write KEY=VALUE"),
    ],
)
def test_impossible_value_is_refused_by_its_full_path(row, override, told):
    assert told in refusal(row, override)


def test_goal_needs_the_firmware(row):
    message = refusal(row, "motion.field=goal", "parcel.0.goal={x_m=0, y_m=0}")
    assert "set run.fidelity to 'firmware'" in message


def test_goal_off_the_table_is_refused(row):
    message = refusal(
        row, "motion.field=goal", "run.fidelity=firmware", "parcel.0.goal={x_m=0, y_m=0.5}"
    )
    assert "parcel.0.goal.y_m is 0.5, which puts the goal off the table" in message


def test_more_cells_than_node_ids_are_refused_with_the_firmware(row):
    assert "at most 126" in refusal(row, "run.fidelity=firmware", "array.rows=13")
    load_scenario(row, ["run.fidelity=ideal", "array.rows=13"])


def test_two_parcels_of_one_name_are_refused(row):
    row.write_text(ROW + '[[parcel]]\nname="box"\nmass_kg=1\nlength_m=0.3\nwidth_m=0.1\n')
    assert "parcel.1.name is 'box', but parcel.0 has that name already" in refusal(row)


@pytest.mark.parametrize(
    ("shape", "x_m", "told"),
    [
        ("rectangle", 0.1798, "begin 0.2 mm within each other; move one of them by its x_m and"),
        ("rectangle", 0.18, None),
        ("disc", 0.0, "begin 180 mm within each other"),
        ("disc", 0.18, None),
    ],
)
def test_parcels_that_begin_within_each_other_are_refused(shape, x_m, told):
    boxes = [
        {"name": "box", "mass_kg": 1, "length_m": 0.36, "width_m": 0.36, "x_m": -0.18},
        {"name": "other", "mass_kg": 1, "length_m": 0.36, "width_m": 0.36, "x_m": x_m},
    ]
    boxes[1]["shape"] = shape
    motion = {"field": "inward", "speed_m_s": 0.1}
    tree = {"scenario": "swap2", "parcel": boxes, "task": [], "motion": motion}
    if told is None:
        scenario_from(tree)
        return
    with pytest.raises(ScenarioError, match=told):
        scenario_from(tree)


@pytest.mark.parametrize("offsets", ["[[0.05, 0], [0.05, 0]]", "[[0, 0.0635], [0, -0.0635]]"])
def test_two_sensors_at_one_place_are_refused(offsets):
    message = refusal("array18", f"cell.sensor_offset_m={offsets}")
    assert "cell.sensor_offset_m.1 is [0" in message
    assert "where sensor 0 of this cell or of a neighbour is" in message
    # The model has no host that looks at them.
    load_scenario("paper-fig7", [f"cell.sensor_offset_m={offsets}"])


def test_a_mass_of_which_no_square_is_left_is_refused():
    expected = "is 1e-300, but must be above 0 and at least 1e-06"
    for key in ("parcel.0.mass_kg", "belief.box.mass_kg"):
        assert f"{key} {expected}" in refusal("array18", f"{key}=1e-300")


@pytest.mark.parametrize(
    ("key", "least"),
    [
        ("run.duration_s", "0.001"),
        ("parcel.0.length_m", "0.001"),
        ("array.pitch_m", "0.001"),
        ("cell.gear_ratio", "1e-06"),
        ("cell.torque_constant_nm_per_a", "1e-06"),
    ],
)
def test_a_value_too_small_to_reckon_with_is_refused(key, least):
    assert f"{key} is 1e-308, but must be at least {least}" in refusal("array18", f"{key}=1e-308")


def test_a_name_that_is_too_long_for_a_file_is_refused():
    assert "cannot be read: File name too long" in refusal("a" * 5000)


def test_missing_key_is_named(row):
    row.write_text(ROW.replace("columns = 10", ""))
    assert "array.columns is missing; give it a whole number" in refusal(row)


def test_bad_toml_is_refused_with_its_line(row):
    row.write_text("title = \n")
    assert "not valid TOML" in refusal(row)
    assert "line 1" in refusal(row)


def test_file_that_is_none_is_refused(tmp_path, row):
    assert "no such scenario file; built-in scenarios: array18" in refusal(tmp_path / "none.toml")
    assert f"{tmp_path}: not a run folder: it has no meta.json; give" in refusal(tmp_path)
    row.write_bytes(b"\xff\xfe\x00")
    assert "is no text in UTF-8; give a TOML file" in refusal(row)


def test_file_that_an_editor_has_marked_as_utf_8_is_read(row):
    plainly = load_scenario(row)
    row.write_bytes(b"\xef\xbb\xbf" + ROW.replace("\n", "\r\n").encode())
    assert load_scenario(row) == plainly


def test_message_names_the_file(row):
    assert refusal(row, "array.columns=0").startswith(f"{row}: ")


def test_spelled_out_tables_mean_the_same(row):
    scenario = load_scenario(row)
    assert scenario_from(spell_out(Scenario, {**plain(scenario), "cell": {}})) == scenario


@pytest.mark.parametrize("tree", [{1: 2}, {"scenario": "array18", "belief": {1: 2}}])
def test_a_key_in_python_that_is_no_text_is_refused(tree):
    with pytest.raises(ScenarioError, match="1 is not a known key; known here"):
        scenario_from(tree)


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(string.printable),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(string.printable), inner, max_size=3)
    ),
    max_leaves=5,
)


@given(
    st.dictionaries(
        st.sampled_from(["title", "array", "cell", "parcel", "motion", "run", "more"]), JSON_VALUES
    )
)
def test_nonsense_is_refused_and_never_crashes(tree):
    with pytest.raises(ScenarioError):
        scenario_from(tree)


@given(
    st.sampled_from(
        ["array.columns", "parcel.0.mass_kg", "cell.friction", "run.seed", "motion.table_m_s"]
    ),
    st.text(string.printable) | st.floats().map(str) | st.integers().map(str),
)
def test_any_override_gives_a_scenario_or_a_refusal(key, value):
    told = key
    try:
        load_scenario("paper-fig7", [f"{key}={value}"])
    except ScenarioError as error:
        told = str(error)
    assert key in told


def test_a_file_may_be_based_on_another_and_has_the_differences(row, tmp_path):
    path = tmp_path / "more.toml"
    path.write_text('scenario = "row.toml"\ntitle = "more"\n[run]\nduration_s = 3.0\n')
    scenario = load_scenario(path)
    assert (scenario.title, scenario.run.duration_s, scenario.array.columns) == ("more", 3.0, 10)
    assert scenario.parcel == load_scenario(row).parcel


def test_tables_in_python_may_be_based_on_a_scenario_too():
    own = {"scenario": "array18", "cell": {"friction": 0.2}}
    scenario = scenario_from(own)
    assert scenario == load_scenario("array18", ["cell.friction=0.2"])
    assert own == {"scenario": "array18", "cell": {"friction": 0.2}}
    with pytest.raises(ScenarioError, match="scenario is 18, but must be the name"):
        scenario_from({"scenario": 18})


def test_a_file_that_is_based_on_itself_is_refused(tmp_path):
    path = tmp_path / "loop.toml"
    path.write_text('scenario = "loop.toml"\n')
    assert "scenario is 'loop.toml', but must be the name of a scenario" in refusal(path)


@pytest.mark.parametrize("name", ["unknown-1", "unknown-20"])
def test_name_that_the_host_gives_to_unknown_things_is_refused(row, name):
    row.write_text(ROW.replace('name = "box"', f'name = "{name}"'))
    assert f"parcel.0.name is {name!r}, but is a name that the host gives" in refusal(row)
