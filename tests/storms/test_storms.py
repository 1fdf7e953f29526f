"""A few storms, those that were found once, and the storms themselves; many are in the benchmarks.

That no rule is broken is asked of every simulated run by `tests/conftest.py`.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_sim.referee.referee import Referee
from mdms_sim.simulation import NS_PER_S, Simulation
from tests.storms.draw import draw
from tests.storms.run import Ended, run
from tests.storms.shrink import shrink
from tests.storms.storm import Storm, load, parts_of, scenario_of, written

FOUND = sorted((Path(__file__).parent / "found").glob("*.toml"))
LASTS_S = 10.0
#: Storms on 6 x 3 cells, two of each kind of loop and job.
SEEDS = {
    "small host goal": (1, 2),
    "small host tasks": (1, 2),
    "small cells goal": (1, 2),
    "small cells tasks": (1, 2),
}


@pytest.mark.parametrize(
    ("setting", "seed"), [(name, seed) for name, seeds in SEEDS.items() for seed in seeds]
)
def test_a_storm_breaks_no_rule_and_a_run_that_ends_early_says_why(setting: str, seed: int) -> None:
    ended = run(draw(seed, setting, LASTS_S))
    assert ended.crash is None
    assert ended.reached or ended.explained, ended


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.stem)
def test_a_fault_that_a_storm_has_found_stays_mended(path: Path) -> None:
    assert run(load(path.read_text("utf-8"))).crash is None


def test_a_storm_gives_the_same_bytes_twice() -> None:
    first, second = (run(draw(5, "small host goal", 2.0)) for _ in range(2))
    assert told(first) == told(second)


def told(ended: Ended) -> Ended:
    """All fields that do not depend on the machine."""
    return replace(ended, wall_s=0.0)


@pytest.mark.parametrize("seed", range(1, 13))
def test_a_storm_is_a_legal_scenario_and_its_file_is_the_whole_of_it(seed: int) -> None:
    storm = draw(seed)
    scenario_of(storm)
    assert load(written(storm)) == storm == draw(seed)


@pytest.mark.violates("apart")
def test_a_storm_reports_violations_and_errors(monkeypatch) -> None:
    storm = with_duration(draw(5, "small host goal"), 0.1)
    with monkeypatch.context() as patch:
        patch.setattr(Referee, "finish", lambda referee: referee._note("apart", "planted"))
        patch.setattr(Referee, "on_tick", raising)
        ended = run(storm)
    assert ended.rules == {"apart"}
    assert "planted error" in str(ended.crash)


def raising(*_: object) -> None:
    raise RuntimeError("planted error")


@pytest.fixture
def simulations(monkeypatch) -> list[Simulation]:
    """The simulations that storms of this test run in."""
    built = []

    def build(*arguments, **options) -> Simulation:
        one = Simulation(*arguments, **options)
        one.boots = []
        one.bus.observe(partial(note_boot, one.boots))
        built.append(one)
        return one

    monkeypatch.setattr("tests.storms.run.Simulation", build)
    return built


def note_boot(boots: list[tuple[float, int]], frame: Frame, now_ns: int) -> None:
    node_id = frame.can_id - cob.HEARTBEAT_BASE
    if node_id > 0 and frame.data == bytes([nmt.INITIALISING]):
        boots.append((now_ns / NS_PER_S, node_id))


def service(*events) -> Storm:
    """A storm of a table that nobody drives, with these events alone."""
    storm = draw(1, "small service").with_faults(())
    return replace(storm, events=({"kind": "empty", "time_s": 0.0}, *events))


def test_commissioning_within_a_storm_turns_both_wheels_of_its_cell_alone(simulations) -> None:
    event = {"kind": "commission", "time_s": 0.5, "cell": 6, "duration_s": 3.0}
    assert run(service(event)).crash is None
    travel_m = simulations[0].world.scene.state.wheels["travel_m"].reshape(-1, 2)
    assert (abs(travel_m[5]) > 0.0005).all()
    assert not np.delete(travel_m, 5, axis=0).any()


def test_commissioning_that_is_killed_turns_nothing_more(simulations) -> None:
    event = {"kind": "commission", "time_s": 0.5, "cell": 6, "duration_s": 0.01}
    assert run(service(event)).crash is None
    assert not simulations[0].world.scene.state.wheels["travel_m"].any()


def test_an_update_within_a_storm_restarts_one_cell_after_the_other(simulations) -> None:
    event = {"kind": "update", "time_s": 0.5, "cells": [3, 4], "duration_s": 8.0}
    assert run(with_duration(service(event), 8.0)).crash is None
    boots = [node for time_s, node in simulations[0].boots if time_s > 0.5]
    assert boots == [3, 4]


def test_a_stop_by_another_program_explains_that_a_storm_ends_early() -> None:
    storm = draw(1, "small host goal").with_faults(())
    ended = run(replace(storm, events=({"kind": "stop_all", "time_s": 0.8},)))
    assert (ended.reached, ended.explained) == (False, True)


def test_another_node_resets_one_cell_within_a_storm(simulations) -> None:
    event = {"kind": "network", "time_s": 0.5, "command": "RESET_NODE", "cell": 3}
    assert run(service(event)).crash is None
    assert [node for time_s, node in simulations[0].boots if time_s > 0.5] == [3]


def test_another_node_that_enables_a_drive_under_a_program_ends_it() -> None:
    storm = draw(1, "small host goal").with_faults(())
    for event in (
        {"kind": "enable", "time_s": 0.9, "cells": [6], "gap_s": 0.005},
        {"kind": "setpoint", "time_s": 0.9, "cell": 6, "speed_m_s": 0.2},
    ):
        ended = run(replace(storm, events=(event,)))
        assert "another program commands drives" in str(ended.reason)
        assert "cell 6" in str(ended.reason)
        assert (ended.reached, ended.explained) == (False, True)


def test_commands_of_another_node_leave_the_rest_of_a_storm_as_it_was(monkeypatch) -> None:
    commands = {"enable", "network", "setpoint"}
    for seed in range(1, 9):
        kept = [each for each in draw(seed).events if each["kind"] not in commands]
        with monkeypatch.context() as patch:
            patch.setattr("tests.storms.draw.COMMANDS", (0,))
            assert draw(seed) == replace(draw(seed), events=tuple(kept))


def test_a_gateway_without_power_forwards_nothing_until_it_has_it_again(monkeypatch) -> None:
    forwarded = {}

    def note(one: Simulation, time_s: float) -> None:
        forwarded[time_s] = sum(way.forwarded for way in one.gateways[0].ways)

    def build(*arguments, **options) -> Simulation:
        one = Simulation(*arguments, **options)
        for time_s in (0.4, 0.5, 0.52, 0.7, 0.8):
            one.kernel.at(round(time_s * NS_PER_S), 0, partial(note, one, time_s))
        return one

    monkeypatch.setattr("tests.storms.run.Simulation", build)
    silent = {"kind": "gateway", "time_s": 0.5, "number": 0, "duration_s": 0.2}
    storm = replace(draw(1, "middle cells goal").with_faults(()), events=(silent,))
    assert run(with_duration(storm, 0.8)).crash is None
    assert forwarded[0.4] < forwarded[0.5]
    assert forwarded[0.52] == forwarded[0.7] < forwarded[0.8]


def with_duration(storm: Storm, duration_s: float) -> Storm:
    run_table = dict(storm.tables["run"]) | {"duration_s": duration_s}
    return replace(storm, tables=dict(storm.tables) | {"run": run_table})


def test_shrinking_keeps_the_cause_and_little_else() -> None:
    storm = next(
        storm
        for storm in (draw(seed, "large host tasks") for seed in range(1, 100))
        if len(parts_of(storm)) > 5 and len(storm.tables["parcel"]) > 2
    )
    needed = [part for part in parts_of(storm) if "parcel" not in part[1]][1::2][:2]
    parcel = storm.tables["parcel"][1]

    def fails(one: Storm) -> bool:
        scenario_of(one)
        return parcel in one.tables["parcel"] and all(part in parts_of(one) for part in needed)

    smallest = shrink(storm, fails)
    assert parts_of(smallest) == needed
    assert smallest.tables["parcel"] == [parcel]
    assert smallest.tables["run"]["duration_s"] < storm.tables["run"]["duration_s"] / 2
