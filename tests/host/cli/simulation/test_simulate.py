"""`mdms simulate` prints the result of a run, keeps it, and can run it again."""

import io
import json
import re
from contextlib import redirect_stdout
from pathlib import Path

import pytest

import mdms_model.scenario
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.simulation.simulate import ready_s
from mdms_model.run.folder import read_run
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.micropython_bank import MicropythonBank

BUILTIN = Path(mdms_model.scenario.__file__).parent / "builtin"


def figures(capsys, *arguments):
    assert main(["simulate", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_json_has_the_promised_names(capsys):
    told = figures(capsys, "paper-fig7", "--set", "run.duration_s=1")
    assert set(told) == {
        "title",
        "fidelity",
        "nodes",
        "seed",
        "duration_s",
        "wall_s",
        "compile_s",
        "real_time_factor",
        "status",
        "reason",
        "parcels",
        "goals",
        "fault",
        "slipping_share",
    }
    assert set(told["parcels"][0]) == {
        "name",
        "x_m",
        "y_m",
        "yaw_rad",
        "vx_m_s",
        "vy_m_s",
        "yaw_rate_rad_s",
        "at_rest",
    }


def test_figure_8_keeps_moving(capsys):
    assert figures(capsys, "paper-fig8")["parcels"][0]["at_rest"] is False


def test_options_stand_above_the_file(capsys):
    told = figures(
        capsys, "paper-fig7", "--seed", 9, "--fidelity", "ideal", "--set", "run.duration_s=0.5"
    )
    assert (told["seed"], told["fidelity"], told["duration_s"]) == (9, "ideal", 0.5)
    assert told["nodes"] is None


def test_run_is_kept_and_gives_the_same_again(capsys, tmp_path):
    folder = tmp_path / "run"
    first = figures(capsys, "paper-fig9", "--set", "run.duration_s=2", "--out", folder)
    assert first["run"] == str(folder)
    assert json.loads((folder / "meta.json").read_text())["figures"] == first
    assert figures(capsys, folder)["parcels"] == first["parcels"]


def test_people_get_sentences(capsys):
    assert main(["simulate", "paper-fig7"]) == 0
    told = capsys.readouterr().out
    assert "Paper, figure 7" in told
    assert "box: x -0.0309 m, y +0.0000 m, yaw +0.0 deg, at rest" in told


def test_goal_that_is_not_reached_is_told_with_the_way_left_and_by_the_exit_code(capsys):
    """A box that no friction moves stands where it was put, though its wheels turn."""
    slippery = ("--set", "cell.friction=0.0001", "--set", "belief.friction=0.3")
    short = ("--set", "run.duration_s=9")
    assert main(["simulate", "array18", *slippery, *short, "--json"]) == 3
    told = capsys.readouterr()
    figures = json.loads(told.out)
    (goal,) = figures["goals"]
    assert goal["parcel"] == "box"
    assert (goal["reached"], goal["time_s"]) == (False, None)
    assert re.match(
        r"box does not get on, \d+ mm from its goal, tried 5 times: stopped", figures["fault"]
    )
    assert goal["position_error_m"] == pytest.approx(0.2, abs=0.03)
    assert abs(goal["yaw_error_rad"]) == pytest.approx(0.52, abs=0.1)
    assert figures["slipping_share"] > 0.7
    slip, warning, stopped, verdict = told.err.splitlines()
    assert "wheels slip under box" in slip
    assert "box does not get on" in warning
    assert float(warning.split()[0]) < 1.5
    assert "tried 5 times: stopped" in stopped
    assert re.match(
        r"mdms: goal not reached: box is 1\d\d\.\d mm and 2\d\.\d degrees from", verdict
    )


def test_goal_that_is_reached_is_told_with_its_time(capsys):
    told = figures(capsys, "array18", "--set", "run.duration_s=5")
    (goal,) = told["goals"]
    assert goal["reached"] is True
    assert goal["position_error_m"] < 0.002
    assert 1.0 < goal["time_s"] < 1.6
    assert told["slipping_share"] < 0.02


def test_fault_of_a_node_is_in_the_figures(capsys, tmp_path):
    scenario = tmp_path / "dies.toml"
    text = (BUILTIN / "array18.toml").read_text()
    fault = '[[fault]]\nkind = "off"\ncells = [8]\nstart_s = 1.0\n'
    short = "duration_s = 2.0\npauses = 0"
    scenario.write_text(text.replace("duration_s = 12.0", short) + fault)
    assert main(["simulate", str(scenario), "--json"]) == 5
    told = capsys.readouterr()
    assert "cell 8 (node 8) has fallen silent" in json.loads(told.out)["fault"]
    assert "mdms: cell 8 (node 8) has fallen silent" in told.err


def test_parcel_that_tips_is_a_failure_and_the_fault_of_its_run(capsys):
    arguments = ["--set", "motion.field=uniform", "--set", "motion.speed_m_s=0.2", "--json"]
    assert main(["simulate", "paper-fig7", *arguments]) == 1
    told = capsys.readouterr()
    fault = json.loads(told.out)["fault"]
    assert re.fullmatch(r"box tips at .* s: the supports no longer hold .*, at x 0\..* m", fault)
    assert f"mdms: {fault}" in told.err


def test_a_scenario_that_states_its_stop_refuses_heavier_parcels(capsys):
    stop = "stop={form='category_1', mass_kg=1.5, speed_m_s=0.6}"
    assert main(["simulate", "array18", "--set", stop]) == 2
    told = "mdms: parcel.0.mass_kg is 2, but the table's emergency stop holds 1.5 kg at most"
    assert told in capsys.readouterr().err


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The output of the demo, its exit code, and its run folder."""
    folder = tmp_path_factory.mktemp("demo") / "run"
    told = io.StringIO()
    with redirect_stdout(told):
        code = main(["demo", "--out", str(folder)])
    return code, told.getvalue(), folder


def test_box_is_carried_and_turned_to_its_goal(demo):
    code, told, _ = demo
    assert code == ExitCode.OK
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
    assert main(["demo", "--json", "--out", str(tmp_path / "run")]) == ExitCode.TIME_LIMIT
    told = capsys.readouterr()
    assert "goal not reached: box is " in told.err
    assert json.loads(told.out)["goals"][0]["reached"] is False


def told(capsys, *arguments):
    assert main([*map(str, arguments), "--json"]) in (0, 3)
    return json.loads(capsys.readouterr().out)


def assert_same_bytes(again, run):
    """All but the load, in which a frame counts that is still under way at the end."""
    for name in ("frames", "errors", "log_sha256"):
        assert again["bus"][name] == run["bus"][name]


@pytest.mark.parametrize("bitrate", [1_000_000, 800_000])
def test_replayed_host_carries_the_parcel_to_the_same_place(capsys, tmp_path, bitrate):
    short = ("--set", "run.duration_s=0.8", "--set", f"wire.bitrate={bitrate}")
    run = told(capsys, "simulate", "array18", *short, "--out", tmp_path / "run")
    again = told(capsys, "replay", tmp_path / "run", "--nodes", "cpython")
    (before,), (after,) = run["parcels"], again["parcels"]
    before.pop("estimate", None)
    assert after == before
    assert_same_bytes(again, run)


def test_micropython_cells_follow_the_same_recording(capsys, tmp_path):
    short = ("--set", "run.duration_s=0.2", "--set", "array.columns=3")
    fidelity = ("--fidelity", "firmware", "--out", tmp_path / "run")
    small = ("--set", "parcel.0.length_m=0.3", "--set", "parcel.0.x_m=0")
    run = told(capsys, "simulate", "paper-fig7", *short, *small, *fidelity)
    again = told(capsys, "replay", tmp_path / "run", "--nodes", "micropython")
    assert again["nodes"] == "micropython"
    assert_same_bytes(again, run)


PROGRAM = {"file": "sorter.py", "source": "async def main(table): pass", "function": "main"}


def run_folder(folder, **changed):
    scenario = {"scenario": {"scenario": "array18", "run": {"duration_s": 0.01}}}
    meta = {"format": "mdms-run", "format_version": 1, **scenario, **changed}
    (folder / "meta.json").write_text(json.dumps(meta))
    return str(folder)


@pytest.mark.parametrize(
    ("table", "values", "told"),
    [
        ("figures", {"bus": 5}, "figures.bus in meta.json is 5"),
        ("figures", {"bus": {}}, "figures.bus in meta.json is {}"),
        ("provenance", {"program": []}, "provenance.program in meta.json is []"),
        ("provenance", {"program": PROGRAM | {"file": None}}, "provenance.program in meta.json is"),
        ("provenance", {"program": PROGRAM | {"source": 5}}, "provenance.program in meta.json is"),
        ("provenance", {"program": PROGRAM | {"function": []}}, "must be a table with the texts"),
        ("provenance", {"program": {"file": "a.py"}}, "its program a.py was not kept"),
    ],
)
def test_a_run_that_tells_what_no_run_does_is_refused(capsys, tmp_path, table, values, told):
    assert main(["simulate", run_folder(tmp_path, **{table: values})]) == ExitCode.USAGE
    assert told in capsys.readouterr().err


def test_the_program_of_a_run_is_written_nowhere_else(tmp_path, monkeypatch):
    for name in ("run", "temporary"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    program = PROGRAM | {"file": "../elsewhere.py"}
    main(["simulate", run_folder(tmp_path / "run", provenance={"program": program})])
    assert not (tmp_path / "temporary" / "elsewhere.py").exists()


@pytest.mark.parametrize("output", ["run", "json"])
def test_a_run_is_kept_up_to_the_death_of_a_cell(capsys, tmp_path, monkeypatch, output):
    tick = MicropythonBank.tick

    def dies(bank, *sensed):
        if bank._conditions.ticks == 60:
            bank._processes[1]._said.write(b"MemoryError")
            bank._processes[1]._said.flush()
            bank._processes[1]._process.kill()
        return tick(bank, *sensed)

    monkeypatch.setattr(MicropythonBank, "tick", dies)
    small = ("--set", "array.columns=3", "--set", "parcel.0.length_m=0.3")
    nodes = ("--set", "parcel.0.x_m=0", "--fidelity", "firmware", "--nodes", "micropython")
    kept = {"run": ("--out", str(tmp_path / "run")), "json": ("--json",)}[output]
    assert main(["simulate", "paper-fig7", *small, *nodes, *kept]) == ExitCode.NODE_FAULT
    told = capsys.readouterr()
    assert told.err == "mdms: cell 2 has died: MemoryError\n"
    figures = json.loads(told.out) if output == "json" else read_run(tmp_path / "run").figures
    assert figures["fault"] == figures["reason"] == "cell 2 has died: MemoryError"
    assert figures["status"] == "fault"
    assert 0.05 <= figures["duration_s"] <= 0.06
    if output == "run":
        assert (tmp_path / "run" / "bus.log").read_text().count("\n") == figures["bus"]["frames"]


@pytest.mark.parametrize("option", [("--only", "cells"), ("-i", "virtual"), ("-c", "name")])
def test_cells_and_a_bus_at_once_are_refused(capsys, tmp_path, option):
    assert main(["replay", str(tmp_path), "--nodes", "cpython", *option]) == 2
    assert "--nodes" in capsys.readouterr().err


def test_frame_is_ready_half_a_bit_before_it_began():
    # 44 bits without data, and at most 8 stuff bits.
    sync = Frame(0x080, b"")
    bits = round((0.001 - ready_s(0.001, sync, 1_000_000)) * 1e6 - 0.5)
    assert 44 <= bits <= 52
    # 800 bits of 1.25 us end at 1 ms; one bit later the log says 1.001 ms for 1.00125 ms.
    first, second = (ready_s(end_s, sync, 800_000) for end_s in (0.001, 0.001001))
    assert second - first == pytest.approx(1.25e-6, abs=1e-12)
