"""Two of a hundred frames get lost all the time: what becomes of a stream, and of a box.

Two rows of `sort54`, undisturbed and with the loss: parcels an hour, those that left by a wrong
exit, those that touched, and runs that were broken off. One row of `neighbours`, whose cells steer,
with the loss: boxes that arrive, by truth and with the host's word within `SAID_S` of it;
the bound is the lower end of a one-sided 95 % confidence interval. `MDMS_CASES` is the number
of seeds (default 3), `MDMS_SEED` the first (default 1), `MDMS_SECONDS` how long a stream lasts
(default 30; a second takes half a second).
"""

import os
from typing import Any

from tests.benchmarks.cells.neighbours import at_least

from mdms_array.figures import stream_figures
from mdms_array.simulation import run_scenario
from mdms_array.source import open_program
from mdms_model.scenario.file import load_scenario

LOSS = "fault=[{kind='loss', probability=0.02}]"
SAID_S = 2.0


def run() -> list[dict[str, Any]]:
    """Rows for the table of benchmarks; the peer of a stream with the loss is one without."""
    cases, first = int(os.environ.get("MDMS_CASES", "3")), int(os.environ.get("MDMS_SEED", "1"))
    seconds = float(os.environ.get("MDMS_SECONDS", "30"))
    seeds = range(first, first + cases)
    print(
        f"MDMS_CASES={cases} MDMS_SEED={first} MDMS_SECONDS={seconds:g} python -m tests.benchmarks "
        f"lost_frames: seeds {first} to {first + cases - 1}",
        flush=True,
    )
    undisturbed = sorted_by_seed("undisturbed", seeds, seconds, (), None)
    disturbed = sorted_by_seed("2 % lost", seeds, seconds, (LOSS,), undisturbed["ours"])
    return [undisturbed, disturbed, steered(seeds)]


def sorted_by_seed(
    name: str, seeds: range, seconds: float, keys: tuple[str, ...], peer: float | None
) -> dict[str, Any]:
    """Parcels an hour of `sort54`, the mean over seeds, and what went wrong."""
    per_hour, wrong, touches, broken_off = 0.0, 0, 0, {}
    for seed in seeds:
        more = [f"run.duration_s={seconds}", f"run.seed={seed}", *keys]
        scenario, _ = open_program("sort54", more)
        finished = run_scenario(scenario)
        figures = stream_figures(scenario, finished.record)
        print(f"  sort54, {name}, seed {seed}: {figures}, {finished.figures['fault']}", flush=True)
        lasted_s = seconds - scenario.stream[0].start_s
        per_hour += 3600.0 * figures["left"] / lasted_s / len(seeds)
        wrong, touches = wrong + figures["wrong"], touches + figures["touches"]
        if finished.record.time_s[-1] < seconds - 0.1:
            broken_off[seed] = finished.figures["fault"]
    return {
        "name": f"sort54, {seconds:g} s, {name}",
        "ours": per_hour,
        "peer": peer,
        "ratio": None if peer is None else per_hour / peer,
        "unit": "parcels/h",
        "cases": len(seeds),
        "wrong_exit": wrong,
        "touches": touches,
        "broken_off": "; ".join(f"{seed}: {why}" for seed, why in broken_off.items()) or None,
    }


def steered(seeds: range) -> dict[str, Any]:
    """The share of boxes of `neighbours` that arrive, and are said to within a while."""
    well, latest_s = 0, 0.0
    for seed in seeds:
        scenario = load_scenario("neighbours", [LOSS, f"run.seed={seed}"])
        finished = run_scenario(scenario)
        (goal,) = (parcel.outcome for parcel in finished.parcels.values())
        events = finished.record.events
        said_s = [event.time_s for event in events if "has arrived" in event.detail]
        print(f"  neighbours, seed {seed}: {goal}, said {said_s}", flush=True)
        if goal.time_s is not None and said_s:
            late_s = said_s[0] - goal.time_s
            latest_s = max(latest_s, late_s)
            well += late_s <= SAID_S
    return {
        "name": "neighbours, 2 % lost: arrived and said so",
        "ours": 100 * well / len(seeds),
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * at_least(well, len(seeds)),
        "cases": len(seeds),
        "latest_s": latest_s,
    }
