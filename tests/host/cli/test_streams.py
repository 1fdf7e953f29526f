"""For any streams, and a signal at any time: one line, and the right exit code."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.streams import EventLines

MDMS = str(Path(sys.executable).with_name("mdms"))
#: A verb that imports little; refusals go the same way for all.
REFUSED = "configure assign --from none.toml"


def shell(line, **environment):
    """A command line of a shell, with `mdms` in it as a word."""
    return subprocess.run(
        ["/bin/sh", "-c", line.replace("mdms ", f"{MDMS} ", 1)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env=os.environ | environment,
    )


@pytest.mark.parametrize(
    ("line", "code", "told"),
    [
        ("mdms scenarios >&-", 0, ""),
        ("mdms scenarios > /dev/full", 1, "mdms: stdout cannot be written: No space left on dev"),
        (f"mdms {REFUSED} >&-", 2, "mdms: none.toml: cannot be read: No such file"),
        (f"mdms {REFUSED} 2>&-", 2, ""),
        (f"mdms {REFUSED} 2> /dev/full", 2, ""),
        (f"mdms {REFUSED} | true; exit 0", 0, "mdms: none.toml: cannot be read: No such file"),
    ],
)
def test_closed_or_full_stream_is_no_traceback(line, code, told):
    done = shell(line)
    assert done.returncode == code
    assert done.stdout == ""
    assert done.stderr.startswith(told)
    assert done.stderr.count("\n") == bool(told)


def test_names_of_a_file_do_not_control_the_terminal(tmp_path, capsys):
    path = tmp_path / "odd.toml"
    path.write_text('title = "odd"\n"\\u001b]0;title\\u0007\\u001b[2J" = 1\n', "utf-8")
    assert main(["simulate", str(path)]) == 2
    said = capsys.readouterr().err
    assert said.rstrip("\n").isprintable()
    assert "\\x1b]0;title\\x07\\x1b[2J" in said


TIPS = "simulate paper-fig7 --set motion.field=uniform --set motion.speed_m_s=0.2"


@pytest.mark.parametrize(
    ("verb", "unbuffered", "told"),
    [
        (TIPS, "", ["mdms: box tips", "1"]),
        (TIPS, "1", ["mdms: box tips", "1"]),
        ("limits paper-fig7", "", ["0"]),
    ],
)
def test_exit_code_stands_though_nobody_reads(verb, unbuffered, told):
    line = f"{{ mdms {verb}; echo $? >&2; }} | true"
    said = shell(line, PYTHONUNBUFFERED=unbuffered).stderr.splitlines()
    assert [each[: len(start)] for each, start in zip(said, told, strict=True)] == told


def test_stream_of_ascii_takes_everything(tmp_path):
    title = (tmp_path / "dots.toml", 'title = "●○ étagère"')
    from mdms_model.scenario import file

    text = (Path(file.__file__).parent / "builtin" / "paper-fig7.toml").read_text("utf-8")
    title[0].write_text(text.replace('title = "Paper, figure 7: full rolling"', title[1]), "utf-8")
    done = shell(f"mdms limits {title[0]}", PYTHONIOENCODING="ascii:strict")
    assert done.returncode == 0, done.stderr
    assert "?? ?tag?re: box" in done.stdout


#: Interrupts itself where a module is imported, as Ctrl-C may; the last is imported by a verb.
INTERRUPTED = """
import builtins, os, signal, sys
imported = builtins.__import__
def interrupting(name, *rest):
    if name == {name!r}:
        os.kill(os.getpid(), signal.SIGINT)
    return imported(name, *rest)
builtins.__import__ = interrupting
from mdms_host.entry import main
sys.argv = ["mdms", "simulate", "paper-fig7"]
sys.exit(main())
"""


@pytest.mark.parametrize("name", ["mdms_host.cli.verbs", "numba"])
def test_interrupt_while_importing_is_one_line(name):
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED.format(name=name)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "mdms: interrupted\n")


#: Prints after a command whether garbage is collected, and how many threads multiply matrices.
AFTER = """
import gc, os, sys
from mdms_host.entry import main
sys.argv = ["mdms", "scenarios"]
main()
import numpy as np
np.ones((800, 800)) @ np.ones((800, 800))
print(gc.isenabled(), len(os.listdir("/proc/self/task")))
"""


def test_a_verb_collects_garbage_and_has_no_threads_beside_the_control_cycle():
    process = [sys.executable, "-c", AFTER]
    done = subprocess.run(process, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "True 1"


def test_error_of_a_file_is_one_line(monkeypatch, capsys):
    def fail(_arguments):
        raise OSError(28, "No space left on device", "run/bus.log")

    monkeypatch.setattr("mdms_host.cli.scenarios.scenarios", fail)
    assert main(["scenarios"]) == ExitCode.FAILURE
    assert capsys.readouterr().err == "mdms: run/bus.log: No space left on device\n"


def test_handlers_of_signals_are_given_back():
    before = signal.getsignal(signal.SIGTERM)
    main(["--version"])
    assert signal.getsignal(signal.SIGTERM) is before


#: A callback of a destructor drops its exceptions, as those from compiled code do.
DROPPED = """
import os, signal, sys, time
from mdms_host.cli.exits import Terminated, ended_by_signals
class Dropping:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
sys.unraisablehook = lambda unraisable: None
try:
    with ended_by_signals():
        Dropping()
        time.sleep(60)
except KeyboardInterrupt as error:
    sys.exit(type(error).__name__)
"""


@pytest.mark.parametrize(("name", "error"), [("SIGTERM", "Terminated"), ("SIGINT", "Interrupted")])
def test_signal_whose_exception_is_dropped_ends_the_command_all_the_same(name, error):
    done = subprocess.run(
        [sys.executable, "-c", DROPPED.format(name=name)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (1, error + "\n")


#: What a command still does after it has told of its end may take long.
SLOW = """
import gc, os, signal, sys, time
from mdms_host import cli
class Parser:
    def parse_args(self, argv): return self
    def run(self, arguments):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(60)
def slow(code):
    gc.collect()
    time.sleep(1.5)
    return code
cli.build_parser, cli.flushed = Parser, slow
sys.exit(cli.main([]))
"""


def test_an_interruption_is_told_once_however_long_the_end_takes():
    done = subprocess.run([sys.executable, "-c", SLOW], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "mdms: interrupted\n")


def test_emergencies_of_many_cells_are_one_line_and_a_count():
    told = []
    lines = EventLines(told.append)
    lines.add(0.5, "running")
    for cell in range(1, 37):
        lines.add(1.0 + cell / 100, f"cell {cell} sends emergency 0x8250: no setpoint for 50 ms")
    lines.add(1.4, "cell 3 sends emergency 0x8130: the host is silent")
    lines.add(1.5, "box has arrived")
    lines.add(1.6, "box has arrived")
    lines.add(3.0, "cell 1 sends emergency 0x8250: no setpoint for 50 ms")
    lines.add(3.1, "cell 2 sends emergency 0x8250: no setpoint for 50 ms")
    lines.finish()
    lines.finish()
    more = "more: cell ... sends emergency 0x8250: no setpoint for 50 ms"
    assert told == [
        "   0.500 s  running",
        "   1.010 s  cell 1 sends emergency 0x8250: no setpoint for 50 ms",
        f"   1.010 s  35 {more}",
        "   1.400 s  cell 3 sends emergency 0x8130: the host is silent",
        "   1.500 s  box has arrived",
        "   1.600 s  box has arrived",
        "   3.000 s  cell 1 sends emergency 0x8250: no setpoint for 50 ms",
        "   3.100 s  cell 2 sends emergency 0x8250: no setpoint for 50 ms",
    ]


def test_what_all_cells_miss_by_one_delay_is_two_lines_with_both_axes_and_their_way_back():
    told = []
    lines = EventLines(told.append)
    for cell in range(1, 19):
        for axis in (1, 2):
            text = f"sends emergency 0x8250: no setpoint for 50 ms (axis {axis})"
            lines.add(1.0, f"cell {cell} (node {cell}) {text}")
    for cell in range(1, 19):
        lines.add(1.5 + cell / 1000, f"cell {cell} (node {cell}) is back")
    lines.add(1.6, "all cells are back after 0.56 s")
    assert told == [
        "   1.000 s  cell 1 (node 1) sends emergency 0x8250: no setpoint for 50 ms (axis 1)",
        "   1.000 s  35 more: cell ... (node ...) sends emergency 0x8250: no setpoint for 50 ms "
        "(axis ...)",
        "   1.501 s  cell 1 (node 1) is back",
        "   1.501 s  17 more: cell ... (node ...) is back",
        "   1.600 s  all cells are back after 0.56 s",
    ]
