"""`mdms demo` does the main job and reports how it went."""

import io
import json
import re
from contextlib import redirect_stdout

import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import Exit


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """What the demo printed, its exit code, and its run folder."""
    folder = tmp_path_factory.mktemp("demo") / "run"
    told = io.StringIO()
    with redirect_stdout(told):
        code = main(["demo", "--out", str(folder)])
    return code, told.getvalue(), folder


def test_box_is_carried_and_turned_to_its_goal(demo):
    code, told, _ = demo
    assert code == Exit.OK
    found = re.search(
        r"box moved ([\d.]+) m and turned \+([\d.]+) degrees; "
        r"it stands ([\d.]+) mm and ([\d.]+) degrees off its goal",
        told,
    )
    moved_m, turned_deg, miss_mm, miss_deg = map(float, found.groups())
    assert moved_m == pytest.approx(0.20, abs=0.01)
    assert turned_deg == pytest.approx(30, abs=3)
    assert miss_mm <= 5
    assert miss_deg <= 1.7


def test_figures_of_the_bus_and_the_picture_are_told(demo):
    _, told, folder = demo
    assert re.search(r"bus: [\d,]+ frames, \d+ % load at 1 Mbit/s", told)
    assert re.search(r"12 s simulated in [\d.]+ s: [\d.]+ times real time", told)
    assert f"picture: {folder / 'picture.png'}" in told
    assert (folder / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_run_folder_is_whole(demo):
    folder = demo[2]
    names = sorted(path.name for path in folder.iterdir())
    assert names == [
        *("bus.log", "lichtblick_layout.json", "mdms-cell.dbc"),
        *("meta.json", "picture.png", "run.mcap"),
    ]
    figures = json.loads((folder / "meta.json").read_text())["figures"]
    assert set(figures["bus"]) == {"frames", "load", "errors", "log_sha256"}
    assert set(figures["parcels"][0]["estimate"]) == {"x_m", "y_m", "yaw_rad"}
    assert figures["nodes"] == "cpython"
    assert figures["bus"]["frames"] == len((folder / "bus.log").read_text().splitlines())


def test_run_of_the_demo_can_be_plotted_and_exported(demo, tmp_path):
    folder = str(demo[2])
    assert main(["plot", folder, "--wheels", "--out", str(tmp_path / "wheels.png")]) == 0
    assert main(["export", folder, "--csv", str(tmp_path)]) == 0
    assert len((tmp_path / "cells.csv").read_text().splitlines()) % 36 == 1


def test_box_that_does_not_arrive_in_time_is_told(monkeypatch, tmp_path, capsys):
    from mdms_model.scenario.file import load_scenario

    short = load_scenario("array18", ["run.duration_s=1"])
    monkeypatch.setattr("mdms_host.cli.simulation.simulate.open_program", lambda *_: (short, None))
    assert main(["demo", "--out", str(tmp_path / "run")]) == Exit.TIME_LIMIT
    assert "goal not reached: box is " in capsys.readouterr().err


def test_demo_has_its_figures_as_json(monkeypatch, tmp_path, capsys):
    from mdms_model.scenario.file import load_scenario

    short = load_scenario("array18", ["run.duration_s=1"])
    monkeypatch.setattr("mdms_host.cli.simulation.simulate.open_program", lambda *_: (short, None))
    assert main(["demo", "--json", "--out", str(tmp_path / "run")]) == Exit.TIME_LIMIT
    assert json.loads(capsys.readouterr().out)["goals"][0]["reached"] is False
