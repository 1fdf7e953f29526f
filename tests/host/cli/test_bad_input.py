"""Bad input ends in one line on stderr and exit code 2, and nothing is written."""

from types import SimpleNamespace

import pytest

from mdms_host.cli import main

SCENARIO = """
title = "a row"
[array]
columns = 10
rows = 1
[[parcel]]
name = "box"
mass_kg = 2.0
length_m = 0.4445
width_m = 0.1
[motion]
speed_m_s = 0.0635
"""


@pytest.fixture
def mdms(tmp_path, monkeypatch, capsys):
    """Runs `mdms` in an empty folder, in this process."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        code = main([str(each) for each in arguments])
        told = capsys.readouterr()
        return SimpleNamespace(returncode=code, stdout=told.out, stderr=told.err)

    return run


def assert_refused(done, told, folder, files=()):
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("mdms")
    assert told in done.stderr
    assert sorted(path.name for path in folder.iterdir()) == sorted(files)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("mass_kg", "mas_kg"), "parcel.0.mas_kg is not a known key; did you mean mass_kg?"),
        (("mass_kg = 2.0", "mass_kg = -2.0"), "parcel.0.mass_kg is -2.0, but must be above 0"),
        (("width_m = 0.1", "width_m = 0.1\nx_m = 0.9"), "parcel.0.x_m is 0.9"),
        (("columns = 10", "columns = 0"), "array.columns is 0, but must be at least 1"),
        (("length_m = 0.4445", 'length_m = "long"'), "parcel.0.length_m is 'long', but must be a"),
        (("rows = 1", "rows = 1 1"), "not valid TOML"),
        (("[motion]", "[run]\ngravity_m_s2 = 1e-320\n[motion]"), "run.gravity_m_s2 is 1e-320, but"),
        (("[motion]", "[cell]\ngain_vs_per_m = 0\n[motion]"), "cell.gain_vs_per_m is 0, but must"),
    ],
)
@pytest.mark.parametrize("verb", [("simulate", "--out", "run", "--json"), ("limits",)])
def test_scenario_that_cannot_be(mdms, tmp_path, verb, change, told):
    (tmp_path / "bad.toml").write_text(SCENARIO.replace(*change))
    assert_refused(mdms(verb[0], "bad.toml", *verb[1:]), told, tmp_path, ["bad.toml"])


@pytest.mark.parametrize("verb", ["simulate", "limits"])
def test_missing_scenario(mdms, tmp_path, verb):
    done = mdms(verb, "none.toml")
    assert_refused(done, "none.toml: no such scenario file; built-in scenarios: array18", tmp_path)


BUS = ("-i", "virtual", "-c", "nobody")


@pytest.mark.parametrize(
    "verb",
    [
        ("simulate",),
        ("limits",),
        ("sweep",),
        ("tune",),
        ("doctor", *BUS, "--array"),
        ("configure", "load", *BUS),
        ("commission", *BUS, "--from"),
    ],
)
def test_a_file_that_no_reader_takes(mdms, tmp_path, verb):
    (tmp_path / "deep.toml").write_text(f"cell = {'[' * 5000}{']' * 5000}\n")
    (tmp_path / "binary.toml").write_bytes(bytes(range(256)))
    files = ["binary.toml", "deep.toml"]
    assert_refused(mdms(*verb, "deep.toml"), "deep.toml: is nested too deeply", tmp_path, files)
    told = "binary.toml: is no text in UTF-8; give a TOML file"
    assert_refused(mdms(*verb, "binary.toml"), told, tmp_path, files)
    assert_refused(mdms(*verb, "a" * 5000), "File name too long", tmp_path, files)


def test_a_parcel_that_lies_between_all_wheels_ends_a_run_in_order(mdms):
    tiny = ("--set", "parcel.0.length_m=0.001", "--set", "parcel.0.width_m=0.001")
    done = mdms("simulate", "sort54", *tiny, "--set", "run.duration_s=1.5")
    assert done.returncode == 1
    assert "tips" in done.stderr


def test_override_that_cannot_be(mdms, tmp_path):
    done = mdms("simulate", "paper-fig7", "--out", "run", "--set", "parcel.0.mass_kg=heavy")
    assert_refused(done, "parcel.0.mass_kg is 'heavy', but must be a number", tmp_path)


@pytest.mark.parametrize("arguments", [("plot", "none"), ("export", "none", "--csv", "tables")])
def test_run_folder_that_is_not_there(mdms, tmp_path, arguments):
    assert_refused(mdms(*arguments), "none: no such run folder", tmp_path)


@pytest.mark.parametrize("arguments", [("plot", "."), ("export", ".", "--csv", "tables")])
def test_run_folder_that_is_none(mdms, tmp_path, arguments):
    assert_refused(mdms(*arguments), "not a run folder", tmp_path)


def test_run_into_foreign_files(mdms, tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    done = mdms("simulate", "paper-fig7", "--out", ".")
    assert_refused(done, "holds files that are no run", tmp_path, ["thesis.tex"])


def test_run_below_a_file(mdms, tmp_path):
    (tmp_path / "file").write_text("mine")
    done = mdms("simulate", "paper-fig7", "--out", "file/run")
    assert_refused(done, "file/run: cannot be made", tmp_path, ["file"])


def test_goal_without_the_cells_sensors(mdms, tmp_path):
    done = mdms("simulate", "array18", "--fidelity", "ideal", "--out", "run")
    assert_refused(done, "set run.fidelity to 'firmware'", tmp_path)


def test_field_table_of_the_wrong_length(mdms, tmp_path):
    done = mdms(
        "simulate", "paper-fig7", "--set", "motion.field=table", "--set", "motion.table_m_s=[1]"
    )
    assert_refused(done, "one speed for each of the 10 wheels", tmp_path)


@pytest.mark.parametrize("field", ["goal", "inward"])
def test_speed_that_the_wire_does_not_carry(mdms, tmp_path, field):
    fast = ("--set", "motion.speed_m_s=20", "--set", f"motion.field={field}")
    done = mdms("simulate", "array18", *fast, "--out", "run")
    assert_refused(done, "a setpoint on the wire is at most 10 m/s", tmp_path)


def test_gain_that_the_firmware_cannot_hold(mdms, tmp_path):
    heavy = ("--set", "cell.rotor_inertia_kg_m2=0.01")
    done = mdms("simulate", "array18", *heavy, "--set", "cell.gain_vs_per_m=1000", "--out", "run")
    assert_refused(done, "cell.gain_vs_per_m does not fit the firmware", tmp_path)


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("fly",),
        ("simulate",),
        ("simulate", "paper-fig7", "--fidelity", "exact"),
        ("simulate", "paper-fig7", "--nodes", "abacus"),
        ("simulate", "paper-fig7", "--seed", "many"),
        ("export", "run"),
    ],
)
def test_bad_usage(mdms, tmp_path, arguments):
    assert_refused(mdms(*arguments), "--help", tmp_path)


@pytest.mark.parametrize("verb", ["simulate", "limits"])
def test_a_box_that_would_tip_is_refused_by_every_verb(capsys, verb):
    small = ("--set", "parcel.0.width_m=0.12", "--set", "parcel.0.length_m=0.12")
    assert main([verb, "array18", *small]) == 2
    assert "would tip at its start" in capsys.readouterr().err
