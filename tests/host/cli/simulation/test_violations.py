"""A rule that a run breaks is in all that it leaves behind, and on the page."""

import json

import pytest
from tests.host.page.bench import Desk

from mdms_array.simulation import run_scenario
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.coordination.coordinator import Coordinator
from mdms_model.run.folder import read_run
from mdms_model.scenario.file import load_scenario

SHORT = ("simulate", "array18", "--set", "run.duration_s=0.3")


@pytest.fixture
def hasty(monkeypatch):
    """The coordinator says at once that everything has arrived."""
    monkeypatch.setattr(Coordinator, "arrived", property(lambda self: self.goals))


@pytest.mark.violates("true")
def test_a_violation_is_in_the_figures_the_run_folder_and_the_exit_code(hasty, tmp_path, capsys):
    out = tmp_path / "run"
    assert main([*SHORT, "--json", "--out", str(out)]) == ExitCode.FAILURE
    printed = capsys.readouterr()
    (violation,) = json.loads(printed.out)["violations"]
    assert set(violation) == {"time_s", "rule", "cell", "parcel", "text"}
    assert [violation[each] for each in ("rule", "cell", "parcel")] == ["true", None, "box"]
    assert violation["time_s"] == pytest.approx(0.025, abs=0.026)
    assert "rule 'true' broken: box has arrived" in printed.err
    meta = json.loads((out / "meta.json").read_text())
    assert meta["figures"]["violations"] == [violation]
    (event,) = [each for each in read_run(out).record.events if each.kind == "violation"]
    assert (event.parcel, event.detail) == ("box", f"true: {violation['text']}")


def test_a_run_that_keeps_the_rules_has_an_empty_list(capsys):
    # The box is not there yet: the time limit.
    assert main([*SHORT, "--json"]) == ExitCode.TIME_LIMIT
    assert json.loads(capsys.readouterr().out)["violations"] == []


@pytest.mark.violates("true")
def test_a_violation_is_among_the_events_of_the_page(hasty, monkeypatch):
    desk = Desk(monkeypatch, load_scenario("array18"))
    desk.slot.start()
    desk.run(0.2)
    (event,) = [
        event
        for message in desk.messages
        if message["kind"] == "events"
        for event in message["events"]
        if "true: box has arrived" in event["text"]
    ]
    assert event["trouble"]


def test_a_parcel_that_is_ordered_on_at_once_is_not_said_to_be_there():
    async def there_and_on(table):
        await table["box"].move(0.0, 0.0, 0.0)
        await table["box"].move(0.06, 0.0, 0.0)

    scenario = load_scenario(
        "array18", ["motion={field='program', speed_m_s=0.2}", "run.duration_s=4"]
    )
    run = run_scenario(scenario, main=there_and_on)
    assert run.status == "reached"
    assert run.violations == ()
