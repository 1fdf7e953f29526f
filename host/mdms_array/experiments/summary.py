"""Summaries: shares by Wilson's interval, medians and quantiles by a seeded bootstrap."""

from collections.abc import Iterable, Mapping, Sequence
from math import isfinite, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.errors import InputError

if TYPE_CHECKING:
    from mdms_array.experiments.sweep import SweepResult

#: Two-sided 95 % of the normal distribution.
Z = 1.959963984540054
#: Quantiles of a summary, and how they are called.
QUANTILES = {"q10": 0.1, "median": 0.5, "q90": 0.9}
RESAMPLES = 2000
#: An interval misses what it is of with this probability.
_MISSED = 0.05
BOOTSTRAP_SEED = 1
#: More samples of a parameter than this are put into classes of equal counts.
MOST_CLASSES = 12
CLASSES = 6
Row = Mapping[str, Any]


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share; all of 0 to 1 without trials."""
    if not trials:
        return 0.0, 1.0
    share, z2 = successes / trials, Z * Z
    middle = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z / (1 + z2 / trials) * sqrt(share * (1 - share) / trials + z2 / (4 * trials * trials))
    # At the ends rounding must not leave out the share itself.
    low = 0.0 if not successes else max(middle - half, 0.0)
    return low, 1.0 if successes == trials else min(middle + half, 1.0)


def bootstrap(values: Sequence[float], quantiles: Sequence[float]) -> Floats:
    """Quantiles of values, and the ends of their 95 % intervals: shape (3, Q).

    Percentile intervals of `RESAMPLES` resamples, drawn from the same seed each time. NaN where
    there are too few values for any interval: a quantile q is below or above all of n values with a
    probability of q^n + (1 - q)^n. That is above 5 % for a median of fewer than 6 values, and for a
    10 % quantile of fewer than 29.
    """
    sample = np.asarray(values, dtype=float)
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    drawn = sample[rng.integers(len(sample), size=(RESAMPLES, len(sample)))]
    ends = np.quantile(np.quantile(drawn, quantiles, axis=1), (0.025, 0.975), axis=1)
    asked = np.asarray(quantiles)
    ends[:, asked ** len(sample) + (1 - asked) ** len(sample) > _MISSED] = np.nan
    return np.vstack((np.quantile(sample, quantiles), ends))


def mean_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """The mean of two values or more, and the ends of its 95 % interval by Student's t."""
    from scipy.stats import t

    sample = np.asarray(values, dtype=float)
    mean, count = float(sample.mean()), len(sample)
    half = float(t.ppf(1 - _MISSED / 2, count - 1) * sample.std(ddof=1) / sqrt(count))
    return mean, mean - half, mean + half


def summarised(result: "SweepResult", by: Sequence[str] | None = None) -> list[dict[str, Any]]:
    """A row for each setting, or each value of the parameters in `by`; see `SweepResult.summary`.

    Runs that raised are counted as `failed`, and in no share or quantile. Those without a value are
    in none either: `NAME_runs` says how many have one.
    """
    parameters = result.parameters if by is None else tuple(by)
    for name in parameters:
        if name not in result.parameters:
            raise InputError(
                f"{name} does not vary; there are {', '.join(result.parameters) or 'none'}"
            )
    classes = {
        name: (lambda value: value) if by is None else _classes(result, name) for name in parameters
    }
    groups: dict[str, tuple[dict[str, Any], list[Row]]] = {}
    for row in result.rows:
        values = {name: classes[name](row[name]) for name in parameters}
        groups.setdefault(repr(values), (values, []))[1].append(row)
    return [_summary(values, rows, result.measures) for values, rows in groups.values()]


def _summary(
    values: dict[str, Any], rows: Sequence[Row], measures: Iterable[str]
) -> dict[str, Any]:
    ran = [row for row in rows if row["failure"] is None]
    summary = values | {"runs": len(rows), "failed": len(rows) - len(ran)}
    for name in measures:
        known = [row[name] for row in ran if row[name] is not None]
        summary[f"{name}_runs"] = len(known)
        if is_share(known):
            low, high = wilson(sum(known), len(known))
            summary |= {
                f"{name}_share": sum(known) / len(known),
                f"{name}_low": low,
                f"{name}_high": high,
            }
        elif is_numeric(known):
            columns = bootstrap(known, tuple(QUANTILES.values())).T.tolist()
            for quantile, (middle, *ends) in zip(QUANTILES, columns, strict=True):
                summary[f"{name}_{quantile}"] = middle
                for end, value in zip(("low", "high"), ends, strict=True):
                    summary[f"{name}_{quantile}_{end}"] = value if isfinite(value) else None
    return summary


def is_share(values: Sequence[Any]) -> bool:
    """Whether values are truths, whose share counts."""
    return bool(values) and all(isinstance(value, bool) for value in values)


def is_numeric(values: Sequence[Any]) -> bool:
    """Whether values are finite numbers, and there are any."""
    return bool(values) and all(
        isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
        for value in values
    )


def _classes(result: "SweepResult", name: str) -> Any:
    """The class of a value of a parameter: itself, or the middle of the class."""
    values = [row[name] for row in result.rows]
    if name not in result.sampled or len({*values}) <= MOST_CLASSES:
        return lambda value: value
    edges = np.quantile(values, np.linspace(0.0, 1.0, CLASSES + 1))

    def middle(value: float) -> float:
        number = int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, CLASSES - 1))
        return float(0.5 * (edges[number] + edges[number + 1]))

    return middle


def cells_of(summary: Row, parameters: Sequence[str], measures: Sequence[str]) -> list[str]:
    """A row of a summary as texts for a printed table."""
    cells = [_text(summary[name]) for name in parameters]
    cells += [str(summary["runs"]), str(summary["failed"])]
    for name in measures:
        known, ran = summary[f"{name}_runs"], summary["runs"] - summary["failed"]
        missing = f", {known} of {ran} runs" if known < ran else ""
        if f"{name}_share" in summary:
            share, low, high = (summary[f"{name}_{end}"] for end in ("share", "low", "high"))
            cells.append(f"{100 * share:.0f} % [{100 * low:.0f}, {100 * high:.0f}]{missing}")
        elif f"{name}_median" in summary:
            median, low, high = (summary[f"{name}_median{end}"] for end in ("", "_low", "_high"))
            interval = "" if low is None else f" [{low:.3g}, {high:.3g}]"
            cells.append(f"{median:.3g}{interval}{missing}")
        else:
            cells.append(missing.removeprefix(", "))
    return cells


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
