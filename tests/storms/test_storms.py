"""A few storms, those that were found once, and the storms themselves; many are in the benchmarks.

That no rule is broken is asked of every simulated run by `tests/conftest.py`.
"""

from dataclasses import replace
from pathlib import Path

import pytest

from mdms_sim.referee.referee import Referee
from tests.storms.run import Ended, run
from tests.storms.shrink import shrink
from tests.storms.storm import Storm, draw, load, parts_of, scenario_of, written

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
def test_what_a_storm_has_found_once_stays_mended(path: Path) -> None:
    assert run(load(path.read_text("utf-8"))).crash is None


def test_a_storm_gives_the_same_bytes_twice() -> None:
    first, second = (run(draw(5, "small host goal", 2.0)) for _ in range(2))
    assert told(first) == told(second)


def told(ended: Ended) -> Ended:
    """All but what the machine has a say in."""
    return replace(ended, wall_s=0.0)


@pytest.mark.parametrize("seed", range(1, 13))
def test_a_storm_is_a_legal_scenario_and_its_file_is_the_whole_of_it(seed: int) -> None:
    storm = draw(seed)
    scenario_of(storm)
    assert load(written(storm)) == storm == draw(seed)


@pytest.mark.violates("apart")
def test_a_storm_reports_what_the_referee_notes_and_what_raises(monkeypatch) -> None:
    storm = with_duration(draw(5, "small host goal"), 0.1)
    with monkeypatch.context() as patch:
        patch.setattr(Referee, "finish", lambda referee: referee._note("apart", "planted"))
        patch.setattr(Referee, "on_tick", raising)
        ended = run(storm)
    assert ended.rules == {"apart"}
    assert "planted error" in str(ended.crash)


def raising(*_: object) -> None:
    raise RuntimeError("planted error")


def with_duration(storm: Storm, duration_s: float) -> Storm:
    run_table = dict(storm.tables["run"]) | {"duration_s": duration_s}
    return replace(storm, tables=dict(storm.tables) | {"run": run_table})


def test_shrinking_keeps_what_breaks_the_rule_and_little_else() -> None:
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
