"""Tuning: values of keys that make a measure small, or large, while others keep their bounds.

Optuna's sampler proposes settings in batches. Each is run with the same seeds, in the journal of a
sweep. The sampler is seeded and batches have a fixed size. So an interrupted tuning proposes the
same settings again, finds their runs in the journal, and goes on where it was.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mdms_array.experiments.measures import check_measures, name_of
from mdms_array.experiments.settings import (
    Distribution,
    check_count,
    check_no_seed,
    has_chance,
    seeds_of,
    tree_of,
)
from mdms_array.experiments.summary import mean_interval
from mdms_array.experiments.sweep import Design, SweepResult
from mdms_array.extras import TUNE, require
from mdms_model.errors import InputError
from mdms_model.scenario.file import scenario_from
from mdms_model.scenario.scenario import ScenarioError

#: Settings that are proposed together, whatever runs them.
BATCH = 4
#: Trials of the best settings are compared with the base on seeds drawn from this one on.
UNSEEN_SEED = 1_000_003
#: The sampler takes seeds below this.
MOST_SEEDS = 1 << 32


@dataclass(frozen=True, slots=True)
class MeasureBound:
    """A bound of the mean of a measure."""

    measure: str
    at_least: float | None = None
    at_most: float | None = None

    def excess(self, mean: float) -> float:
        """How far a mean is beyond the bound; 0 or less within."""
        beyond = [] if self.at_least is None else [self.at_least - mean]
        return max(beyond + ([] if self.at_most is None else [mean - self.at_most]))


@dataclass(frozen=True, slots=True)
class TuningProblem:
    """What is tuned: `design` has the base as its only setting, and all measures.

    `objective` is the measure whose mean is to be small, or with `maximise` large. `unseen` is the
    number of seeds on which the best setting is compared with the base: 1 where all runs are alike.
    """

    design: Design
    vary: Mapping[str, Distribution]
    objective: str
    maximise: bool
    bounds: tuple[MeasureBound, ...]
    trials: int
    seed: int
    unseen: int


@dataclass(frozen=True, slots=True)
class Trial:
    """A setting, the mean of the objective, and the sum of all excess over bounds.

    The mean is None where a run has failed or has no value.
    """

    setting: Mapping[str, Any]
    mean: float | None
    excess: float

    @property
    def is_within(self) -> bool:
        """Whether it keeps all bounds."""
        return self.mean is not None and self.excess <= 0.0


#: A mean, and the ends of its 95 % interval.
Gain = tuple[float, float | None, float | None]


@dataclass(frozen=True, slots=True)
class Tuned:
    """All trials, the base first; the best; and both on seeds that no trial has seen.

    `gain` is how much better the best is there than the base, in the mean of pairs, with the ends
    of its 95 % interval, which runs without chance do not have. It is None where the base is the
    best, or a run has no value.
    """

    trials: Sequence[Trial]
    best: Trial
    importance: Mapping[str, float]
    base_unseen: Trial
    best_unseen: Trial
    gain: Gain | None

    @property
    def is_better(self) -> bool:
        """Whether the best is surely better than the base on unseen seeds, and keeps its bounds."""
        if self.gain is None or not self.best_unseen.is_within:
            return False
        mean, low, _ = self.gain
        return (mean if low is None else low) > 0.0


def task_of(
    design: Design,
    vary: Mapping[str, Distribution],
    *,
    objective: str,
    maximise: bool,
    bounds: Sequence[MeasureBound],
    trials: int,
    seed: int,
    unseen: int,
) -> TuningProblem:
    """A checked task, with the base's values as the first setting. Raises `InputError`."""
    check_count("trials", trials)
    # One pair has no interval.
    check_count("unseen", unseen, least=2)
    if not 0 <= seed < MOST_SEEDS:
        raise InputError(f"seed is {seed}, but must be 0 to {MOST_SEEDS - 1:,}: the sampler's")
    if not vary:
        raise InputError("vary: no key varies; give one or more, each with a distribution")
    names = {name_of(each) for each in check_measures(design.measures)}
    for name in (objective, *(bound.measure for bound in bounds)):
        if name not in names:
            raise InputError(f"{name} is not measured; there are {', '.join(sorted(names))}")
    for key in vary:
        check_no_seed("vary", key)
    base = {key: _base_value(design.base, key) for key in vary}
    for key, value in base.items():
        limits = vary[key]
        if not limits.low <= value <= limits.high:
            raise InputError(
                f"vary: {key} is {value:g} in the scenario, which {limits} leaves out; widen it"
            )
        if limits.kind == "integers" and value != int(value):
            raise InputError(
                f"vary: {key} is {value:g} in the scenario, which {limits} leaves out: the first "
                "trial is the scenario itself; give it uniform, or a whole number in the scenario"
            )
    _check_first(design, vary, base)
    return TuningProblem(
        replace(design, settings=[base]),
        *(vary, objective, maximise, tuple(bounds), trials, seed),
        unseen if has_chance(design.base, vary) else 1,
    )


def _check_first(
    design: Design, vary: Mapping[str, Distribution], base: Mapping[str, float]
) -> None:
    """Raises `ScenarioError` where the scenario's own values are none of the distributions' kind.

    Those of `uniform` and `log_uniform` are no whole numbers.
    """
    first = {
        key: value if vary[key].kind == "integers" else float(value) for key, value in base.items()
    }
    try:
        scenario_from(tree_of(design.base, first, design.seeds[0]))
    except ScenarioError as error:
        raise ScenarioError(f"vary: the first trial cannot be run: {error}") from None


def _base_value(base: Mapping[str, Any], key: str) -> float:
    value: Any = base
    for part in key.removeprefix("truth.").split("."):
        if isinstance(value, list) and part.isdecimal() and int(part) < len(value):
            value = value[int(part)]
        elif isinstance(value, list):
            value = next((each for each in value if each.get("name") == part), None)
        else:
            value = value.get(part) if isinstance(value, Mapping) else None
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise InputError(f"vary: {key} has no number in the scenario to begin with; give it one")
    return value


def tune(task: TuningProblem, run: Callable[[Design], SweepResult]) -> Tuned:
    """Try settings, and compare the best with the base. `run` does the runs that a journal lacks.

    Raises `Error` where the extra is not installed.
    """
    require(TUNE, "tuning")
    # It is an extra.
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=task.seed)
    direction = optuna.study.StudyDirection[("MINIMIZE", "MAXIMIZE")[task.maximise]]
    study = optuna.create_study(sampler=sampler, direction=direction)
    study.enqueue_trial(dict(task.design.settings[0]))
    trials: list[Trial] = []
    while len(trials) < task.trials:
        count = min(BATCH, task.trials - len(trials))
        asked = [study.ask() for _ in range(count)]
        settings = [
            {key: _suggest(each, key, task.vary[key]) for key in task.vary} for each in asked
        ]
        done = _trials(task, run(replace(task.design, settings=settings)), settings)
        for each, trial in zip(asked, done, strict=True):
            each.set_constraint("bounds", trial.excess)
            if trial.mean is None:
                study.tell(each, state=optuna.trial.TrialState.FAIL)
            else:
                study.tell(each, trial.mean)
        trials += done
    best = _best(task, trials)
    base_unseen, best_unseen, gain = _compare(task, run, trials[0], best)
    # All but failures of a machine is in the journal by now; the last table is that of all trials.
    run(replace(task.design, settings=[dict(each.setting) for each in _once(trials)]))
    return Tuned(trials, best, _importance(study), base_unseen, best_unseen, gain)


def _suggest(trial: Any, key: str, values: Distribution) -> float:
    if values.kind == "integers":
        return int(trial.suggest_int(key, int(values.low), int(values.high)))
    log = values.kind == "log_uniform"
    return float(trial.suggest_float(key, values.low, values.high, log=log))


def _trials(
    task: TuningProblem, result: SweepResult, settings: Sequence[Mapping[str, Any]]
) -> list[Trial]:
    """The trial of each setting, from its rows."""
    trials = []
    for setting in settings:
        rows = [row for row in result.rows if all(row[key] == setting[key] for key in setting)]
        mean = _mean(rows, task.objective)
        excess = 0.0
        for bound in task.bounds:
            bounded = _mean(rows, bound.measure)
            excess += np.inf if bounded is None else max(bound.excess(bounded), 0.0)
        trials.append(Trial(setting, mean, float(min(excess, 1e9))))
    return trials


def _mean(rows: Sequence[Mapping[str, Any]], name: str) -> float | None:
    values = [row[name] for row in rows]
    if any(value is None or isinstance(value, str) for value in values):
        return None
    return float(np.mean(values))


def _once(trials: Sequence[Trial]) -> list[Trial]:
    """Trials without those whose setting was tried before."""
    return list({repr(sorted(each.setting.items())): each for each in trials}.values())


def _best(task: TuningProblem, trials: Sequence[Trial]) -> Trial:
    """The best of the trials within bounds; the trial with the least excess where none is."""
    sign = -1.0 if task.maximise else 1.0
    valid = [each for each in trials if each.mean is not None] or list(trials[:1])
    return min(valid, key=lambda each: (each.excess, sign * (each.mean or 0.0)))


def _compare(
    task: TuningProblem, run: Callable[[Design], SweepResult], base: Trial, best: Trial
) -> tuple[Trial, Trial, Gain | None]:
    """Base and best on seeds that no trial has seen, and the gain."""
    settings = [dict(each.setting) for each in _once([base, best])]
    unseen = seeds_of(task.unseen, task.seed + UNSEEN_SEED)
    result = run(replace(task.design, settings=settings, seeds=unseen))
    of_base, of_best = _trials(task, result, [base.setting, best.setting])
    if len(settings) == 1 or of_base.mean is None or of_best.mean is None:
        return of_base, of_best, None
    values = np.array([float(row[task.objective]) for row in result.rows]).reshape(2, -1)
    pairs = ((values[1] - values[0]) * (1.0 if task.maximise else -1.0)).tolist()
    gain: Gain = mean_interval(pairs) if len(pairs) > 1 else (pairs[0], None, None)
    return of_base, of_best, gain


def _importance(study: Any) -> dict[str, float]:
    """How much of the objective's variation each key explains; empty for too few trials."""
    import optuna

    evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    with warnings.catch_warnings():
        # It warns where trials are too few, and shares are then equal.
        warnings.simplefilter("error")
        try:
            return dict(optuna.importance.get_param_importances(study, evaluator=evaluator))
        except (ValueError, RuntimeError, UserWarning):
            return {}
