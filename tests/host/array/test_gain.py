"""The largest gain is shown; verbs that drive cells refuse a larger one with that number."""

import json
from contextlib import redirect_stdout
from functools import cache
from io import StringIO

import pytest

from mdms_host.cli import main

SHORT = ("--set", "run.duration_s=0.01", "--set", "motion.field=inward")


@cache
def limits(*arguments):
    """The output of `mdms limits` about the gain."""
    with redirect_stdout(StringIO()) as printed:
        assert main(["limits", *arguments, "--json"]) == 0
    return json.loads(printed.getvalue())


def set_gain(gain_vs_per_m):
    return ("--set", f"cell.gain_vs_per_m={gain_vs_per_m!r}")


def test_largest_gain_has_a_margin_of_45_degrees():
    largest = limits("array18")["gain_max_vs_per_m"]
    told = limits("array18", *set_gain(largest))
    assert told["gain_vs_per_m"] == told["gain_max_vs_per_m"] == largest
    assert told["phase_margin_deg"] == pytest.approx(45.0, abs=0.5)


def test_lighter_wheel_takes_less_gain():
    light = limits("array18", "--set", "cell.wheel_inertia_kg_m2=0")
    assert light["gain_max_vs_per_m"] < limits("array18")["gain_max_vs_per_m"]
    assert light["phase_margin_deg"] < limits("array18")["phase_margin_deg"]


def test_massless_wheels_have_no_largest_gain(capsys):
    told = limits("paper-fig7")
    assert (told["gain_max_vs_per_m"], told["phase_margin_deg"]) == (None, None)
    assert main(["limits", "paper-fig7"]) == 0
    assert "none, for the wheels have no inertia" in capsys.readouterr().out


def test_loop_that_never_reaches_a_gain_of_1_has_no_margin():
    assert limits("array18", *set_gain(1.0))["phase_margin_deg"] is None


def test_people_see_limit_and_margin(capsys):
    told = limits("array18")
    assert main(["limits", "array18"]) == 0
    row = capsys.readouterr().out.splitlines()[-1]
    assert f"{told['gain_max_vs_per_m']:.4g} V s/m" in row
    assert f"(10 has {told['phase_margin_deg']:.0f})" in row


@pytest.mark.parametrize(
    "verb",
    [("simulate",), ("serve",), ("run", "-i", "virtual", "-c", "nobody")],
    ids=lambda verb: verb[0],
)
def test_larger_gain_is_refused_with_the_limit(capsys, verb):
    largest = limits("array18")["gain_max_vs_per_m"]
    assert main([*verb, "array18", *set_gain(1.01 * largest)]) == 2
    out, told = capsys.readouterr()
    assert told.startswith("mdms: cell.gain_vs_per_m: ")
    assert told.endswith(f"the largest that leaves 45 is {largest:.4g} V s/m\n")
    assert (out, told.count("\n")) == ("", 1)


def test_largest_gain_itself_is_run():
    largest = limits("array18")["gain_max_vs_per_m"]
    assert main(["simulate", "array18", *SHORT, *set_gain(largest)]) == 0


def test_papers_law_is_not_limited():
    assert main(["simulate", "paper-fig7", *SHORT, *set_gain(1000.0)]) == 0
    inertia = ("--set", "cell.rotor_inertia_kg_m2=2e-6")
    assert main(["simulate", "paper-fig7", *SHORT, *inertia, *set_gain(1000.0)]) == 0
