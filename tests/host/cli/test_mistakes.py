"""Mistakes of users, each answered with what is wrong, where, and what to do."""

import errno
import json
from argparse import Namespace

import can
import pytest

from mdms_host.can_link.link import NoBusError, open_bus
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.programs.script import BLOCKED_S, Script, ScriptError, until


def test_a_misspelt_scenario_is_answered_with_the_name_that_was_meant(capsys):
    assert main(["simulate", "aray18"]) == ExitCode.USAGE
    assert "did you mean array18?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("interface", "number", "cure"),
    [
        ("socketcan", errno.EAFNOSUPPORT, "sudo modprobe can"),
        ("socketcan", errno.ENODEV, "ip link show type can"),
        ("slcan", errno.EACCES, "sudo usermod -a -G dialout $USER"),
    ],
)
def test_a_bus_that_the_system_refuses_is_told_once_with_its_cure(
    monkeypatch, interface, number, cure
):
    def refuse(_options):
        raise can.CanInitializationError("cannot") from OSError(number, "the system's own words")

    monkeypatch.setattr("mdms_host.can_link.link.create_bus_from_namespace", refuse)
    with pytest.raises(NoBusError) as refused:
        open_bus(Namespace(interface=interface, channel="x0"))
    assert cure in str(refused.value)
    assert str(refused.value).count("x0 cannot be opened") == 1


def test_a_setting_behind_node_is_answered_with_the_order(capsys):
    assert main(["configure", "set", "--node", "all", "gain=12"]) == ExitCode.USAGE
    assert "write all else before --node" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("cell.friction=0", "cell.friction is 0, so no wheel can push a parcel"),
        ("cell.friction=1e-320", "; give 1e-06 or more, as in cell.friction=0.3"),
        ("motion.speed_m_s=0", "motion.speed_m_s is 0, which is the highest speed"),
    ],
)
def test_steering_without_any_push_or_speed_is_refused(capsys, override, told):
    assert main(["simulate", "array18", "--set", override]) == ExitCode.USAGE
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "code", "told"),
    [
        ("await table['bx'].move(0, 0)", ExitCode.TIME_LIMIT, "did you mean 'box'?"),
        ("table['box'].move(0.0, 0.0)", ExitCode.FAILURE, "move() has no await before it"),
        ("raise ValueError('two\\nlines')", ExitCode.FAILURE, "ValueError: two lines, in main (wr"),
        ("raise asyncio.CancelledError", ExitCode.FAILURE, "failed: CancelledError, in main (wr"),
        ("raise ValueError", ExitCode.FAILURE, "failed: ValueError, in main (wrong.py, line 4)"),
        ("await asyncio.sleep(1)", ExitCode.FAILURE, "await table.sleep(1.0) in place of asyncio"),
    ],
)
def test_a_wrong_line_of_a_program_is_named_with_its_place(tmp_path, capsys, line, code, told):
    path = tmp_path / "wrong.py"
    text = f"import asyncio\nSCENARIO = 'array18'\nasync def main(table):\n    {line}\n"
    path.write_text(text)
    assert main(["simulate", str(path)]) == code
    err = capsys.readouterr().err
    assert told in err
    assert "wrong.py, line 4)" in err
    assert "RuntimeWarning" not in err


def test_a_call_without_await_whose_value_has_a_name_is_named_with_its_task():
    async def job():
        pass

    async def main():
        kept = job()
        await until(lambda: kept is not None)

    script = Script()
    script.start(main())
    line = main.__code__.co_firstlineno
    with pytest.raises(ScriptError, match=rf"nothing, in main \(test_mistakes.py, line {line}"):
        script.step()


def test_the_print_of_a_program_leaves_the_json_alone(tmp_path, capsys):
    path = tmp_path / "talks.py"
    path.write_text(
        "SCENARIO = 'array18'\nprint('at import')\n"
        "async def main(table):\n    print('in the run')\n"
    )
    assert main(["simulate", str(path), "--json"]) == ExitCode.OK
    told = capsys.readouterr()
    assert json.loads(told.out)["status"] == "reached"
    assert "at import" in told.err
    assert "in the run" in told.err


def test_a_program_that_blocks_is_named_with_the_lines_and_the_time():
    script, now_s, gate = Script(), [0.0], []

    async def blocking():
        await until(lambda: bool(gate))
        now_s[0] += 0.3
        await until(lambda: False)

    script.watch(lambda: now_s[0])
    script.start(blocking())
    script.step()
    assert script.blocked == []
    gate.append(True)
    script.step()
    ((where, took_s),) = script.blocked
    first = blocking.__code__.co_firstlineno + 1
    assert where == f"test_mistakes.py, from line {first} to line {first + 2}"
    assert took_s == pytest.approx(0.3)
    assert took_s > BLOCKED_S


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate", "array18", "--set", "parcel.0.yaw_rad=30"),
        ("plan-squeeze", "array18", "--yaw", "30"),
    ],
)
def test_an_angle_in_degrees_is_refused_with_its_radians(capsys, arguments):
    assert main([*arguments]) == ExitCode.USAGE
    assert "30 degrees are 0.5236 rad" in capsys.readouterr().err


def test_a_parcel_that_is_lifted_away_at_the_end_does_not_rest(capsys):
    lift = "fault=[{kind='lift', parcel='box', start_s=0.5}]"
    options = ("--set", lift, "--set", "run.duration_s=1.2")
    assert main(["simulate", "array18", *options, "--json"]) != ExitCode.OK
    (box,) = json.loads(capsys.readouterr().out)["parcels"]
    assert (box["lifted"], box["at_rest"]) == (True, False)


def test_a_parcel_that_is_lifted_away_from_its_goal_has_not_reached_it(capsys):
    """The host takes some time to doubt, so by its belief the box is still there."""
    lift = "fault=[{kind='lift', parcel='box', start_s=0.69}]"
    there = "parcel.0.goal={x_m=-0.10, y_m=0.0, yaw_rad=0.0}"
    options = ("--set", lift, "--set", there, "--set", "run.duration_s=0.7")
    assert main(["simulate", "array18", *options, "--json"]) == ExitCode.TIME_LIMIT
    told = capsys.readouterr()
    (goal,) = json.loads(told.out)["goals"]
    assert (goal["reached"], goal["position_error_m"], goal["time_s"]) == (False, None, None)
    assert "goal not reached: box is not on the table" in told.err


def test_a_run_folder_repeats_its_program_and_says_whether_the_bus_agrees(tmp_path, capsys):
    path, folder = tmp_path / "lifts.py", tmp_path / "run"
    path.write_text(
        "SCENARIO = 'array18'\nasync def main(table):\n    await table['box'].move(-0.05, 0.0)\n"
    )
    assert main(["simulate", str(path), "--out", str(folder), "--json"]) == ExitCode.OK
    first = json.loads(capsys.readouterr().out)
    path.unlink()
    assert main(["simulate", str(folder), "--json"]) == ExitCode.OK
    again = json.loads(capsys.readouterr().out)
    assert again["repeats"] is True
    assert again["bus"]["log_sha256"] == first["bus"]["log_sha256"]
    assert again["parcels"][0]["x_m"] == first["parcels"][0]["x_m"]
    told = json.loads((folder / "meta.json").read_text())["provenance"]
    assert "table['box'].move(-0.05, 0.0)" in told["program"]["source"]
    assert told["command"]
    assert "numpy" in told["packages"]


@pytest.mark.slow
def test_a_goal_that_is_never_sure_is_not_told_as_a_program_that_is_late(capsys):
    noisy = ("--set", "cell.sensor_noise=0.2", "--set", "run.duration_s=5")
    assert main(["simulate", "array18", *noisy]) == ExitCode.TIME_LIMIT
    err = capsys.readouterr().err
    assert "the program" not in err
    assert "box is near its goal, but does not count as arrived" in err
