"""The command as a whole: it is light, ends with the right code, and says what is asked."""

import json
import subprocess
import sys

import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import CommandError, Exit

HEAVY = ("numpy", "numba", "matplotlib", "mcap", "rich", "can", "canopen", "serial", "asyncio")


def test_help_imports_nothing_heavy():
    script = (
        "import sys, json; from mdms_host.cli import main; main(['--help']); "
        "print(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    modules = {name.partition(".")[0] for name in json.loads(done.stderr)}
    assert modules.isdisjoint(HEAVY)


def test_model_runs_without_drawing_bus_or_files():
    script = (
        "import sys, json; from mdms_host.cli import main; "
        "main(['simulate', 'paper-fig7', '--set', 'run.duration_s=0.1']); "
        "print(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    modules = {name.partition(".")[0] for name in json.loads(done.stderr.splitlines()[-1])}
    assert modules.isdisjoint({"matplotlib", "mcap", "rich", "can", "canopen", "serial"})


def test_help_lists_the_verbs(capsys):
    assert main(["--help"]) == 0
    told = capsys.readouterr().out
    for verb in ("demo", "simulate", "scenarios", "limits", "plot", "export"):
        assert f"\n    {verb} " in told or f"\n    {verb}\n" in told


def test_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.count(".") == 2


def test_exit_codes_are_the_promised_ones():
    assert {code.name: code.value for code in Exit} == {
        "OK": 0,
        "FAILURE": 1,
        "USAGE": 2,
        "TIME_LIMIT": 3,
        "NO_DEVICE": 4,
        "NODE_FAULT": 5,
    }


def raising(error):
    def run(_arguments):
        raise error

    return run


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (KeyboardInterrupt(), 130, "mdms: interrupted\n"),
        (CommandError("no bus", Exit.NO_DEVICE), 4, "mdms: no bus\n"),
    ],
)
def test_error_becomes_one_line_and_a_code(monkeypatch, capsys, error, code, told):
    monkeypatch.setattr("mdms_host.cli.scenario.scenarios.run", raising(error))
    assert main(["scenarios"]) == code
    assert capsys.readouterr() == ("", told)


def test_reader_that_goes_away_is_no_error():
    program = "from mdms_host.cli import main; raise SystemExit(main(['limits', 'paper-fig7']))"
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 0
