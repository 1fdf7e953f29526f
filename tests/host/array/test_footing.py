"""A parcel that would tip is refused by name before anything moves."""

import pytest

from mdms_array.source import open_program
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode, exit_of
from mdms_model.errors import InputError
from mdms_model.scenario.file import builtin_names

SMALL = ("parcel.0.length_m=0.25", "parcel.0.width_m=0.20")
#: Between two rows of wheels, which it covers both.
SAFE = ("parcel.0.x_m=-0.20", "parcel.0.y_m=-0.065")


def refusal(*overrides):
    with pytest.raises(InputError) as refused:
        open_program("array18", overrides)
    assert exit_of(refused.value) is ExitCode.USAGE
    return str(refused.value)


@pytest.mark.parametrize("name", builtin_names())
def test_scenarios_that_come_with_the_package_are_accepted(name):
    open_program(name, ())
    open_program(name, ("run.fidelity=firmware",))


def test_a_goal_that_ends_off_the_table_is_refused():
    text = refusal("parcel.0.goal.x_m=0.37", "parcel.0.goal.y_m=0.18")
    assert text.startswith("parcel.0: 'box' (rectangle, 0.36 m x 0.3 m) would tip at its goal")
    assert "at x 0.370 m, y 0.180 m, turned by 30 degrees" in text
    assert "53.0 mm outside its supports, and 10 mm are needed" in text


@pytest.mark.parametrize("key", ["parcel.0.length_m", "belief.box.length_m"])
def test_a_size_in_millimetres_is_refused(key):
    text = refusal(f"{key}=360")
    assert text.startswith("parcel.0: 'box' has 360 m from corner to corner, but the table has 0.7")
    assert text.endswith("give its size in metres")


def test_a_start_between_supports_is_refused():
    assert "would tip at its start, at x -0.100 m" in refusal(*SMALL)


def test_a_way_that_leads_between_supports_is_refused_though_both_ends_stand():
    goal = "parcel.0.goal={ x_m = -0.20, y_m = 0.065 }"
    assert "would tip on its way" in refusal(*SMALL, *SAFE, goal)


def test_a_parcel_that_no_field_steers_counts_where_it_starts():
    open_program("array18", (*SMALL, *SAFE, "motion.field=uniform", "motion.speed_m_s=0.05"))
    assert "at its start" in refusal(*SMALL, "motion.field=uniform", "motion.speed_m_s=0.05")


def test_the_papers_model_may_tip():
    open_program("array18", (*SMALL, "motion.field=uniform", "run.fidelity=ideal"))


@pytest.mark.parametrize("verb", ["simulate", "serve", "run"])
def test_every_verb_that_moves_parcels_refuses(verb, capsys):
    options = [text for each in SMALL for text in ("--set", each)]
    assert main([verb, "array18", *options]) == ExitCode.USAGE
    assert "would tip" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("keys", "width"),
    [
        (["parcel.0.length_m=0.20", "parcel.0.width_m=0.20"], "0.2"),
        (["parcel.0.width_m=0.25"], "0.25"),
        (["parcel.0.shape='disc'", "parcel.0.length_m=0.24", "parcel.0.width_m=0.24"], "0.24"),
    ],
)
def test_a_parcel_too_small_for_cells_that_steer_is_refused_with_the_least_width(keys, width):
    with pytest.raises(InputError, match=rf"is {width} m wide, .* none below 0\.254 m"):
        open_program("neighbours", keys)


@pytest.mark.parametrize(
    ("keys", "across"),
    [
        (["parcel.0.length_m=0.44", "parcel.0.width_m=0.30"], "0.533"),
        (["parcel.0.shape='disc'", "parcel.0.length_m=0.52", "parcel.0.width_m=0.52"], "0.52"),
    ],
)
def test_a_parcel_too_large_for_the_steps_of_a_hold_is_refused_with_the_greatest_size(keys, across):
    keys = ["array.columns=8", "parcel.0.goal.yaw_rad=0.0", *keys]
    with pytest.raises(InputError, match=rf"is {across} m across, .* none above 0\.508 m"):
        open_program("neighbours", keys)
    open_program("neighbours", [*keys, "motion.control='host'"])


def test_a_size_too_rough_for_cells_that_steer_is_refused_with_the_limit():
    rough = "belief.box.size_spread_m=0.003"
    told = r"'box' is told within 3 mm \(size_spread_m\), but must be within 2 mm for cells that"
    with pytest.raises(InputError, match=told):
        open_program("neighbours", [rough])
    open_program("neighbours", [rough, "motion.control='host'"])
    open_program("neighbours", ["belief.box.size_spread_m=0.002"])
