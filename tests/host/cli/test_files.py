"""Files of verbs have the form of their name, are whole or absent, and never replace others."""

import errno
import json
from pathlib import Path

import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_model.run.folder import TABLES
from mdms_model.scenario.file import load_scenario

BEGINS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF", "gif": b"GIF8"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files") / "run"
    short = ("--set", "run.duration_s=0.1")
    assert main(["simulate", "paper-fig7", *short, "--out", str(folder)]) == 0
    return str(folder)


def writers(run, path):
    """Command lines that write a picture, or a table, at a path."""
    return {
        "plot": ["plot", run, "--out", str(path)],
        "map": ["map", "paper-fig7", "--set", "array.columns=4", "--out", str(path)],
        "export": ["export", run, "--csv", str(path.parent)],
    }


@pytest.mark.parametrize("form", BEGINS)
def test_picture_is_of_the_form_that_its_name_says(run, tmp_path, form):
    paths = [tmp_path / f"{name}.{form}" for name in "ab"]
    for path in paths:
        assert main(["plot", run, "--out", str(path)]) == 0
    assert paths[0].read_bytes().startswith(BEGINS[form])
    assert paths[0].read_bytes() == paths[1].read_bytes()


STILLS = ".png, .svg or .pdf"


@pytest.mark.parametrize(
    "case",
    [
        (("plot", "RUN"), ".jpeg", ".png, .svg, .pdf, .gif or .mp4"),
        (("plot", "RUN", "--wheels"), ".gif", STILLS),
        (("map", "paper-fig7"), ".mp4", STILLS),
    ],
)
def test_picture_of_an_unknown_form_is_refused_by_its_ending(run, tmp_path, capsys, case):
    command, ending, forms = case
    given = [run if part == "RUN" else part for part in command]
    assert main([*given, "--out", str(tmp_path / f"a{ending}")]) == ExitCode.USAGE
    assert capsys.readouterr().err == (
        f"mdms: {ending}: nothing is drawn in that form; the name is to end in {forms}\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_picture_without_an_ending_is_a_png(run, tmp_path):
    assert main(["plot", run, "--out", str(tmp_path / "picture")]) == 0
    assert (tmp_path / "picture").read_bytes().startswith(BEGINS["png"])


@pytest.mark.parametrize(("verb", "name"), [("plot", "mine.svg"), ("export", "cells.csv")])
def test_own_file_is_written_again_and_others_only_by_force(run, tmp_path, capsys, verb, name):
    path = tmp_path / name
    command = writers(run, path)[verb]
    assert main(command) == 0
    assert main(command) == 0
    path.write_text("mine")
    assert main(command) == ExitCode.USAGE
    assert "--force overwrites it" in capsys.readouterr().err
    assert path.read_text() == "mine"
    assert main([*command, "--force"]) == 0
    assert path.read_text() != "mine"


def test_a_link_stays_and_leads_to_the_new_file(run, tmp_path):
    link, file = tmp_path / "link.png", tmp_path / "kept" / "file"
    file.parent.mkdir()
    link.symlink_to(file)
    for _ in range(2):
        assert main(["plot", run, "--out", str(link)]) == 0
        assert link.is_symlink()
        assert file.read_bytes().startswith(BEGINS["png"])
        assert list(file.parent.iterdir()) == [file]


def full(*_arguments, **_options):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    "case",
    [
        ("plot", "a.png", "matplotlib.figure.Figure.savefig"),
        ("export", "cells.csv", "mdms_model.run.folder.csv.writer"),
    ],
)
def test_full_disk_is_one_line_one_code_and_nothing_half_written(
    run, tmp_path, capsys, monkeypatch, case
):
    verb, name, what = case
    command = writers(run, tmp_path / name)[verb]
    assert main(command) == 0
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    capsys.readouterr()
    monkeypatch.setattr(what, full)
    assert main(command) == ExitCode.FAILURE
    told = capsys.readouterr().err
    assert told.startswith(f"mdms: {tmp_path}")
    assert told.endswith("cannot be written: No space left on device\n")
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_paths_are_given_as_json_too(run, tmp_path, capsys):
    picture = tmp_path / "a.png"
    assert main([*writers(run, picture)["plot"], "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"picture": str(picture)}
    assert main([*writers(run, picture)["export"], "--json"]) == 0
    tables = json.loads(capsys.readouterr().out)["tables"]
    assert [Path(table).name for table in tables] == [*TABLES]
    assert Path(tables[0]).read_text().startswith("time_s,")


def test_folder_of_another_run_is_overwritten_by_force_only(tmp_path, capsys):
    folder = tmp_path / "run"

    def simulate(seed, *more):
        short = ("--set", "run.duration_s=0.05", "--seed", str(seed))
        return main(["simulate", "paper-fig7", *short, "--out", str(folder), *more])

    def seed():
        return json.loads((folder / "meta.json").read_text())["figures"]["seed"]

    # The same run again is no loss.
    assert [simulate(1), simulate(1)] == [ExitCode.OK, ExitCode.OK]
    capsys.readouterr()
    assert simulate(2) == ExitCode.USAGE
    assert capsys.readouterr().err == (
        f"mdms: {folder}: holds another run; --force overwrites it, or give another folder with "
        "--out\n"
    )
    assert seed() == 1
    assert simulate(2, "--force") == ExitCode.OK
    assert seed() == 2


@pytest.mark.parametrize(
    "verb", [("run", "array18", "-i", "virtual"), ("serve", "array18"), ("demo",)]
)
def test_other_verbs_keep_the_folder_of_a_run_too(run, capsys, verb):
    assert main([*verb, "--out", run]) == ExitCode.USAGE
    assert "holds another run; --force overwrites it" in capsys.readouterr().err


def test_demo_overwrites_its_own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for scenario in ("neighbours", "array18"):
        short = load_scenario(scenario, ["run.duration_s=0.1"])
        monkeypatch.setattr(
            "mdms_host.cli.simulation.simulate.open_program", lambda *_, s=short: (s, None)
        )
        assert main(["demo", "--json"]) == ExitCode.TIME_LIMIT


@pytest.mark.parametrize(
    "what", ["mdms_sim.bus.log.BusLog.on_frame", "mdms_array.recording.write_run"]
)
def test_full_disk_ends_a_run_in_the_same_way_and_leaves_the_old_one(
    tmp_path, capsys, monkeypatch, what
):
    folder = tmp_path / "run"
    field = ("--set", "motion.field=inward", "--set", "run.duration_s=0.05")
    command = ["simulate", "array18", *field, "--out", str(folder)]
    assert main(command) == 0
    before = {path: path.read_bytes() for path in folder.iterdir()}
    capsys.readouterr()
    monkeypatch.setattr(what, full)
    assert main(command) == ExitCode.FAILURE
    assert (
        capsys.readouterr().err == f"mdms: {folder}: cannot be written: No space left on device\n"
    )
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    assert list(tmp_path.iterdir()) == [folder]
