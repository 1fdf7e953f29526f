"""Progress and notices appear on a terminal only, without colour where none is wanted."""

import io
import re
from contextlib import redirect_stderr

import pytest

from mdms_array.simulation import NOTICE, compiling_watched
from mdms_host.cli.console import bars, progress

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


@pytest.fixture
def slow(monkeypatch):
    """Any compiling takes long enough to be worth a line."""
    monkeypatch.setattr("mdms_array.simulation.REPORTED_S", 0.0)


def test_long_compiling_is_told_once_on_a_terminal(terminal, slow):
    assert shown(terminal, compile_something).count(NOTICE) == 1


def test_long_compiling_is_not_told_off_a_terminal(capsys, slow):
    compile_something()
    assert capsys.readouterr().err == ""


def test_short_compiling_is_not_told(terminal, monkeypatch):
    monkeypatch.setattr("mdms_array.simulation.REPORTED_S", 1e6)
    assert shown(terminal, compile_something) == ""
