"""Programs in Python on a simulated table with its page."""

from contextlib import contextmanager

import numpy as np
import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import INTERRUPTED
from mdms_host.cli.simulation import live
from mdms_model.run.folder import read_run
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

    def slot_of(scenario, main, _recipes):
        given.append((scenario.title, main.__name__))
        raise KeyboardInterrupt

    monkeypatch.setattr(live, "slot_of", slot_of)
    assert main(["serve", program, "--page", "0"]) == INTERRUPTED
    assert [name for _, name in given] == ["main"]


def test_served_table_keeps_the_beliefs_and_plans_of_programs_of_its_page(tmp_path, monkeypatch):
    out, ends_s = tmp_path / "run", []

    @contextmanager
    def attended(_scenario, slot, server, _arguments, *, recipes, over, kept):
        slot.start()

        def over_or_done():
            now_s = server.simulation.kernel.now_ns / 1e9
            if slot.coordinator.stopped:
                ends_s.append(now_s)
                slot.start()
            elif now_s > 0.8 and not ends_s:
                slot.stop_all()
            return over() or bool(ends_s and now_s > ends_s[0] + 0.8)

        yield over_or_done

    monkeypatch.setattr(live, "attended", attended)
    serve = ["serve", "array18", "--page", "0", "--name", str(tmp_path / "sock"), "--out", str(out)]
    assert main(serve) == 0
    record = read_run(out).record
    assert np.isfinite(record.estimate).all(axis=(1, 2)).any()
    texts = [event.text for event in record.events if event.kind == "coordinator"]
    assert texts.count("running") == 2
    begins_s = [plan.time_s for plan in record.plans if plan.ways]
    assert begins_s[0] < ends_s[0] < begins_s[-1]
    assert all(plan.goals["box"][0] == pytest.approx(0.1) for plan in record.plans)
