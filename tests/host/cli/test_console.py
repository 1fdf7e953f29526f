"""Progress and notices appear on a terminal only, without colour where none is wanted."""

import io
import re
from contextlib import redirect_stderr
from functools import partial

import pytest
from rich.progress import Progress

from mdms_array.simulation import NOTICE, compiling_watched
from mdms_host.cli import main
from mdms_host.cli.console import bars, progress, working
from mdms_host.cli.streams import open_streams
from mdms_model.compiled import WAITING

COLOURS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
COLOUR = re.compile(r"\x1b\[[0-9;]*3[0-9]")


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return Terminal()


def half_way():
    with progress("carrying") as advance:
        advance(0.5)


def shown(screen, work):
    with redirect_stderr(screen):
        work()
    return screen.getvalue()


def test_progress_is_drawn_on_a_terminal(terminal):
    told = shown(terminal, half_way)
    assert "carrying" in told
    assert "50%" in told
    assert COLOUR.search(told)


def two_boards():
    with bars(["/dev/ttyACM0", "/dev/ttyACM1"]) as advance:
        advance("/dev/ttyACM1", 0.5)


def test_each_of_several_has_a_bar_of_its_own(terminal):
    told = shown(terminal, two_boards)
    assert re.search(r"/dev/ttyACM0.* 0%", COLOURS.sub("", told))
    assert re.search(r"/dev/ttyACM1.* 50%", COLOURS.sub("", told))


def test_several_bars_are_not_drawn_off_a_terminal(capsys):
    two_boards()
    assert capsys.readouterr() == ("", "")


def test_no_color_is_honoured(terminal, monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    told = shown(terminal, half_way)
    assert "50%" in told
    assert not COLOUR.search(told)


def test_nothing_is_drawn_off_a_terminal(capsys):
    half_way()
    assert capsys.readouterr() == ("", "")


def compile_something():
    import numba

    inner = numba.njit(lambda x: x + 1)
    with compiling_watched() as compiled:
        numba.njit(lambda x: inner(x) + 2)(1)
        once_s = compiled.seconds
        inner(1)
    assert 0.0 < once_s == compiled.seconds


def test_a_wait_for_another_compiler_counts_as_compiling_and_loading_code_does_not():
    from numba.core.event import trigger_event

    with compiling_watched() as compiled:
        with trigger_event("numba:compiler_lock"):
            assert compiled.seconds == 0.0
        assert compiled.seconds == 0.0
        with trigger_event(WAITING):
            pass
        assert compiled.seconds > 0.0


@pytest.fixture
def slow(monkeypatch):
    """Any compiling takes long enough to be worth a line; lines of the log are told."""
    open_streams()
    monkeypatch.setattr("mdms_array.simulation.REPORTED_S", 0.0)


def test_long_compiling_is_told_once_on_a_terminal(terminal, slow):
    assert shown(terminal, compile_something).count(NOTICE) == 1


def test_long_compiling_is_not_told_off_a_terminal(capsys, slow):
    compile_something()
    assert capsys.readouterr().err == ""


def test_short_compiling_is_not_told(terminal, monkeypatch):
    monkeypatch.setattr("mdms_array.simulation.REPORTED_S", 1e6)
    assert shown(terminal, compile_something) == ""


def test_a_step_without_a_measure_says_what_it_does_on_a_terminal_alone(terminal, capsys):
    def draw():
        with working("drawing [red]a.gif"):
            pass

    assert "drawing [red]a.gif" in COLOURS.sub("", shown(terminal, draw))
    draw()
    assert capsys.readouterr() == ("", "")


def test_a_run_shows_its_share_and_then_its_pictures_and_so_do_plots_and_tables(
    terminal, tmp_path, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "200")
    shares = []
    update = Progress.update
    monkeypatch.setattr(
        Progress,
        "update",
        lambda bar, task, *, completed: (
            update(bar, task, completed=completed),
            shares.append(bar.tasks[0].percentage),
        ),
    )
    folder, picture = tmp_path / "run", tmp_path / "a.gif"
    lines = {
        "and its pictures": ("simulate", "array18", "--set", "run.duration_s=2", "--out", folder),
        "drawing": ("plot", folder, "--out", picture),
        "writing the tables": ("export", folder, "--csv", tmp_path / "tables"),
        "bounds of box": ("limits", "paper-fig7"),
        "mapping the field": ("map", "paper-fig7", "--out", tmp_path / "map.png"),
    }
    for told, arguments in lines.items():
        told_so_far = shown(Terminal(), partial(main, [*map(str, arguments)]))
        assert told in COLOURS.sub("", told_so_far)
    assert 40.0 < shares[len(shares) // 2] < 60.0
