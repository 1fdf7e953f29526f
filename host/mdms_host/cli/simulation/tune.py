"""`mdms tune`: values of keys that make a measure small while others keep their bounds."""

import json
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mdms_array.experiments.files import read_tuning
from mdms_array.experiments.journal import writing
from mdms_array.experiments.pictures import draw_tuning
from mdms_array.experiments.settings import TRUTH, numbered
from mdms_array.experiments.sweep import Design, SweepResult
from mdms_array.experiments.tuning import Trial, Tuned, TuningProblem, tune
from mdms_array.extras import TUNE, require
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.simulation.sweep import running, tell_failures
from mdms_host.cli.streams import kept_for_json
from mdms_sim.plots.canvas import save

PICTURE = "tuning.png"


def run(arguments: Namespace) -> ExitCode:
    """Tune, draw the history, and print the best values beside those of the scenario."""
    require(TUNE, "mdms tune")
    with kept_for_json(arguments.json):
        task = read_tuning(arguments.file)
    folder = arguments.out or Path("runs") / arguments.file.stem
    rows: list[Mapping[str, Any]] = []

    def run_noted(design: Design) -> SweepResult:
        result = run_missing(design)
        rows.extend(result.rows)
        return result

    with running(folder, arguments) as run_missing:
        tuned = tune(task, run_noted)
    with writing(folder / PICTURE):
        save(draw_tuning(tuned, task.objective), folder / PICTURE)
    if arguments.json:
        print(json.dumps(_figures(task, tuned, folder)))
    else:
        print(*_report(task, tuned), f"  picture: {folder / PICTURE}", sep="\n")
    tell_failures(rows)
    return ExitCode.OK if tuned.best.is_within else ExitCode.FAILURE


def _figures(task: TuningProblem, tuned: Tuned, folder: Path) -> dict[str, Any]:
    def figures(trial: Trial) -> dict[str, Any]:
        return {"setting": trial.setting, "mean": trial.mean, "within_bounds": trial.is_within}

    return {
        "objective": task.objective,
        "trials": len(tuned.trials),
        "best": figures(tuned.best),
        "base": figures(tuned.trials[0]),
        "best_unseen": figures(tuned.best_unseen),
        "base_unseen": figures(tuned.base_unseen),
        "gain": tuned.gain,
        "better": tuned.is_better,
        "importance": tuned.importance,
        "folder": str(folder),
    }


def _report(task: TuningProblem, tuned: Tuned) -> list[str]:
    alike = task.unseen == 1
    unseen = "run again" if alike else f"on {task.unseen} unseen seeds"
    lines = [
        f"{len(tuned.trials)} trials of {len(task.design.seeds)} seeds, mean {task.objective}",
        f"  the scenario's own: {_shown(tuned.trials[0])}, {unseen} {_shown(tuned.base_unseen)}",
        f"  the best: {_shown(tuned.best)}, {unseen} {_shown(tuned.best_unseen)}",
        *(f"    {_shown_value(task, *pair)}" for pair in tuned.best.setting.items()),
    ]
    if tuned.best.mean is None:
        lines.append(f"  no trial has a mean: a run failed, or gave no number of {task.objective}")
    elif not tuned.best.is_within:
        lines.append("  no trial keeps all bounds; the best is the one that is least beyond them")
    elif tuned.best.setting == tuned.trials[0].setting:
        lines.append("  no trial is better than the scenario's own values")
    elif tuned.gain is None:
        where = "" if alike else f" {unseen}"
        lines.append(f"  they cannot be compared{where}: a run failed, or gave no number")
    else:
        gain, low, high = tuned.gain
        verdict = "the best is better" if tuned.is_better else "no sure difference"
        told = "in one run of each: without chance all are alike"
        if low is not None:
            told = f"[{low:.3g}, {high:.3g}] {unseen}, in pairs"
        lines.append(f"  {verdict}: by {gain:.3g} {told}")
    return lines


def _shown_value(task: TuningProblem, key: str, value: float) -> str:
    """A value as `mdms simulate` takes it; as a key of this file where it takes none."""
    shown = value if isinstance(value, int) else f"{value:.6g}"
    if key.startswith(TRUTH):
        return f"{key} = {shown}"
    return f"--set {numbered(task.design.base, key)}={shown}"


def _shown(trial: Trial) -> str:
    if trial.mean is None:
        return "failed"
    return f"{trial.mean:.4g}{'' if trial.is_within else ' (beyond bounds)'}"
