"""Programs in Python on a simulated table with its page."""

from contextlib import contextmanager

import pytest

from mdms_host.cli import main
from mdms_host.cli.simulation import live
from mdms_sim.serve import clock

pytest.importorskip("starlette")

PROGRAM = """
SCENARIO = "array18"
print("executed")

async def main(table):
    print("begun")
"""


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    return str(path)


@pytest.fixture
def soon(monkeypatch):
    """The machine's time passes by waiting for it, and nobody presses Ctrl-C for so long [ms]."""
    elapsed_ms, end_ms = 0, 2500

    def wait(_seconds):
        nonlocal elapsed_ms
        elapsed_ms += 1

    @contextmanager
    def interrupted():
        yield lambda: elapsed_ms >= end_ms

    monkeypatch.setattr(clock.time, "monotonic_ns", lambda: 1_000_000 * elapsed_ms)
    monkeypatch.setattr(live, "sleep", wait)
    monkeypatch.setattr(live, "interrupted", interrupted)


def test_demo_with_its_page_begins_the_main_of_a_file(program, soon, capsys):
    assert main(["demo", program, "--page", "0"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (lines.count("executed"), lines.count("begun")) == (1, 1)


def test_demo_without_a_page_begins_it_too(program, tmp_path, capsys):
    assert main(["demo", program, "--out", str(tmp_path / "run")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (lines.count("executed"), lines.count("begun")) == (1, 1)


def test_the_place_at_a_served_table_has_the_main_of_a_file(program, monkeypatch):
    given = []

    def seat_of(scenario, main):
        given.append((scenario.title, main.__name__))
        raise KeyboardInterrupt

    monkeypatch.setattr(live, "seat_of", seat_of)
    assert main(["serve", program, "--page", "0"]) == 0
    assert [name for _, name in given] == ["main"]
