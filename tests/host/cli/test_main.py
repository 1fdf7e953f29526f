"""The command as a whole: it is light, ends with the right code, and prints the requested text."""

import json
import os
import subprocess
import sys
from importlib import import_module

import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import EXITS, CommandError, ExitCode, exit_of
from mdms_host.cli.parser import Verb
from mdms_host.cli.verbs import VERBS
from mdms_host.commissioning.cell_settings import StrangerError
from mdms_host.commissioning.network import SilentError

HEAVY = {"numpy", "numba", "matplotlib", "mcap", "rich", "can", "canopen", "serial", "asyncio"}


def imported_by(*lines):
    """Top-level packages that these command lines import."""
    script = (
        f"import sys, json; from mdms_host.cli import main; [*map(main, {lines!r})]; "
        "print(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    return {name.partition(".")[0] for name in json.loads(done.stderr.splitlines()[-1])}


def test_help_and_usage_errors_import_nothing_heavy():
    lines = ("--help", "--version", "scenarios --help", "simulate --fidelity none")
    assert imported_by(*map(str.split, lines)).isdisjoint(HEAVY)


def test_a_user_whom_no_list_names_may_run_a_table():
    script = (
        "import pwd, sys; from mdms_host.entry import main; "
        "pwd.getpwuid = {}.__getitem__; sys.exit(main())"
    )
    verb = ("run", "array18", "-i", "virtual", "-c", "x", "--limit", "0.1")
    environment = {
        name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_STATE_HOME")
    }
    done = subprocess.run(
        [sys.executable, "-c", script, *verb],
        env=environment,
        capture_output=True,
        check=False,
        text=True,
    )
    assert "Traceback" not in done.stderr
    assert done.returncode == ExitCode.NO_DEVICE


def test_model_runs_without_drawing_or_the_libraries_of_hardware():
    short = ("simulate", "paper-fig7", "--set", "run.duration_s=0.1")
    assert imported_by(short).isdisjoint({"matplotlib", "canopen", "serial"})


def functions(verbs: tuple[Verb, ...]):
    for verb in verbs:
        yield from filter(None, (verb.function, verb.late_options))
        yield from functions(verb.actions)


@pytest.mark.parametrize("function", sorted({*functions(VERBS)}))
def test_every_function_of_the_table_is_there(function):
    module, _, name = function.partition(":")
    assert callable(getattr(import_module(module), name))


@pytest.mark.parametrize("name", EXITS)
def test_every_error_of_the_table_is_there(name):
    module, _, error = name.rpartition(".")
    assert issubclass(getattr(import_module(module), error), Exception)


def test_nearest_class_of_an_error_decides_its_exit_code():
    assert exit_of(SilentError("")) is ExitCode.NO_DEVICE
    assert exit_of(StrangerError("")) is ExitCode.NODE_FAULT
    assert exit_of(CommandError("", ExitCode.USAGE)) is ExitCode.USAGE
    assert exit_of(ValueError("")) is None


def test_error_that_is_a_defect_is_not_hidden(monkeypatch):
    monkeypatch.setattr("mdms_host.cli.scenarios.scenarios", raising(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        main(["scenarios"])


def test_help_lists_the_verbs(capsys):
    assert main(["--help"]) == 0
    told = capsys.readouterr().out
    for verb in ("demo", "simulate", "scenarios", "limits", "plot", "export"):
        assert f"\n    {verb} " in told or f"\n    {verb}\n" in told


def test_exit_codes_are_the_promised_ones():
    assert {code.name: code.value for code in ExitCode} == {
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
        (CommandError("no bus", ExitCode.NO_DEVICE), 4, "mdms: no bus\n"),
        (SilentError("node 3 is silent"), 4, "mdms: node 3 is silent\n"),
    ],
)
def test_error_becomes_one_line_and_a_code(monkeypatch, capsys, error, code, told):
    monkeypatch.setattr("mdms_host.cli.scenarios.scenarios", raising(error))
    assert main(["scenarios"]) == code
    assert capsys.readouterr() == ("", told)
