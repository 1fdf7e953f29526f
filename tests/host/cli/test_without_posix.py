"""The core works without POSIX's modules, as on Windows; the rest says what it lacks."""

import json
import subprocess
import sys

import pytest

from mdms_host.cli.exits import ExitCode

#: Runs the command as if Python were built for such a system.
SCRIPT = """
import os, signal, socket, sys

LACKING = {"fcntl", "termios", "tty", "pty", "resource", "grp", "pwd", "curses", "readline"}


class Finder:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in LACKING:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Finder())
for name in LACKING:
    sys.modules.pop(name, None)
for module, names in (
    (socket, ("AF_UNIX",)),
    (os, ("openpty", "getuid", "geteuid", "fchmod", "fork")),
    (signal, ("SIGHUP", "SIGKILL", "SIGALRM", "SIGUSR1")),
):
    for name in names:
        if hasattr(module, name):
            delattr(module, name)

from mdms_host.entry import main

sys.argv = ["mdms", *sys.argv[1:]]
sys.exit(main())
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("elsewhere")
    script = folder / "elsewhere.py"
    script.write_text(SCRIPT)

    def run(*arguments):
        return subprocess.run(
            [sys.executable, str(script), *map(str, arguments)],
            capture_output=True,
            text=True,
            cwd=folder,
            timeout=600,
            check=False,
        )

    return run


def test_table_is_simulated_drawn_and_exported(run, tmp_path):
    folder = tmp_path / "run"
    short = ("--set", "run.duration_s=0.2", "--out", folder, "--json")
    done = run("simulate", "array18", *short)
    # The box is not there yet.
    assert done.returncode == ExitCode.TIME_LIMIT, done.stderr
    assert json.loads(done.stdout)["bus"]["frames"] > 20
    for more in (
        ("plot", folder),
        ("export", folder, "--csv", tmp_path / "tables"),
        ("map", "paper-fig7", "--out", tmp_path / "map.png"),
    ):
        drawn = run(*more)
        assert drawn.returncode == ExitCode.OK, drawn.stderr
    assert (tmp_path / "tables" / "cells.csv").is_file()


def test_program_runs_over_python_can(run):
    done = run("run", "array18", "-i", "virtual", "-c", "nobody", "--limit", "0.2")
    assert done.returncode in (ExitCode.NO_DEVICE, ExitCode.TIME_LIMIT, ExitCode.NODE_FAULT), (
        done.stderr
    )
    assert "Traceback" not in done.stderr


def test_pages_of_a_table_are_imported(run):
    code = "import mdms_host.cli.simulation.live, mdms_host.cli.live_page, mdms_array"
    script = SCRIPT.replace("\nsys.exit(main())\n", f"\n{code}\nprint('imported')\n")
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.stdout == "imported\n", done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("serve", "array18"), ExitCode.FAILURE, "Unix sockets and pseudo-terminals"),
        (("scan", "-i", "mdms", "-c", "array18"), ExitCode.NO_DEVICE, "which this system has not"),
        (("report",), ExitCode.FAILURE, "over a Unix socket, which this system has not"),
    ],
)
def test_served_buses_say_what_they_lack(run, arguments, code, says):
    done = run(*arguments)
    assert says in done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == code


def test_script_blocks_the_modules():
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.partition("from mdms_host")[0] + "import fcntl"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "No module named 'fcntl'" in done.stderr
