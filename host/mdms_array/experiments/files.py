"""Files of sweeps and of tuning: TOML with a scenario, the keys that vary, and what to measure."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mdms_array.experiments.measures import FileFunction, Measure, measure_named, name_of
from mdms_array.experiments.settings import (
    Distribution,
    Values,
    integers,
    is_number,
    log_uniform,
    uniform,
)
from mdms_array.experiments.sweep import Design, design_of
from mdms_array.experiments.tuning import MeasureBound, TuningProblem, task_of
from mdms_array.source import Source
from mdms_model.errors import InputError
from mdms_model.scenario.file import builtin_names, read_toml
from mdms_sim.plots.canvas import PictureFormatError, form_of

DISTRIBUTIONS: Mapping[str, Callable[..., Distribution]] = {
    each.__name__: each for each in (uniform, log_uniform, integers)
}
SWEEP_KEYS = (
    *("scenario", "over", "seeds", "seed", "samples", "sampling", "measures", "program", "plot"),
)
TUNE_KEYS = (
    *("scenario", "vary", "seeds", "seed", "trials", "unseen", "minimise", "maximise"),
    *("bounds", "measures", "program"),
)
TRIALS, TRIAL_SEEDS, UNSEEN = 40, 8, 20
_GIVEN = ("seeds", "seed", "samples", "sampling")
_RANGE = ("from", "to", "count", "log")


@dataclass(frozen=True, slots=True)
class Plot:
    """One picture of a sweep: its file, its measure, and the parameters it is drawn over."""

    file: str
    measure: str | None = None
    over: tuple[str, ...] | None = None


def read_sweep(path: Path) -> tuple[Design, tuple[Plot, ...]]:
    """The design and the pictures that a file describes. Raises `InputError`."""
    tree = read_table(path, SWEEP_KEYS)
    given: dict[str, Any] = {name: tree[name] for name in _GIVEN if name in tree}
    if "measures" in tree:
        given["measures"] = measures_of(path, tree["measures"])
    try:
        design = design_of(
            _source_of(path, tree),
            _varied(tree, "over"),
            program=_program_of(path, tree),
            **given,
        )
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None
    return design, _plots(path, tree.get("plot", []), design)


def read_tuning(path: Path) -> TuningProblem:
    """The task of tuning that a file describes. Raises `InputError`."""
    tree = read_table(path, TUNE_KEYS)
    goals = [key for key in ("minimise", "maximise") if key in tree]
    if len(goals) != 1 or not isinstance(tree[goals[0]], str):
        raise InputError(f"{path}: give minimise or maximise, and to one of them a measure")
    objective = measure_named(tree[goals[0]], path.parent)
    bounds = _bounds(path, tree.get("bounds", {}))
    measures = dict.fromkeys(
        [objective, *bounds.values(), *measures_of(path, tree.get("measures", []))]
    )
    try:
        vary = _varied(tree, "vary")
        distributions = {key: each for key, each in vary.items() if isinstance(each, Distribution)}
        if len(distributions) < len(vary):
            raise InputError(
                "vary: give each key a distribution, such as { uniform = [LOW, HIGH] }"
            )
        seed = tree.get("seed", 1)
        design = design_of(
            _source_of(path, tree),
            {},
            seeds=tree.get("seeds", TRIAL_SEEDS),
            seed=seed,
            measures=list(measures),
            program=_program_of(path, tree),
            tuned=distributions,
        )
        return task_of(
            design,
            distributions,
            objective=name_of(objective),
            maximise=goals[0] == "maximise",
            bounds=list(bounds),
            trials=tree.get("trials", TRIALS),
            seed=seed,
            unseen=tree.get("unseen", UNSEEN),
        )
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None


def _bounds(path: Path, table: Any) -> dict[MeasureBound, Measure]:
    """The bounds of a file, each with its measure. Raises `InputError`."""
    if not isinstance(table, Mapping):
        raise InputError(f"{path}: bounds is {table!r}, but must be a table")
    bounds: dict[MeasureBound, Measure] = {}
    for name, limits in table.items():
        numbers = [*limits.values()] if isinstance(limits, Mapping) else []
        known = isinstance(limits, Mapping) and {*limits} <= {"at_least", "at_most"}
        if not known or not numbers or not all(map(is_number, numbers)):
            raise InputError(
                f"{path}: bounds.{name} is {limits!r}, but must be {{ at_least = LOW }}, "
                "{ at_most = HIGH }, or both, of finite numbers"
            )
        if len(numbers) > 1 and limits["at_least"] > limits["at_most"]:
            raise InputError(
                f"{path}: bounds.{name} has at_least {limits['at_least']:g} above at_most "
                f"{limits['at_most']:g}, so nothing keeps both; exchange them"
            )
        measure = measure_named(name, path.parent)
        bounds[MeasureBound(name_of(measure), **limits)] = measure
    return bounds


def read_table(path: Path, known: tuple[str, ...]) -> dict[str, Any]:
    """A file with these keys and no others. Raises `InputError`."""
    tree = read_toml(path)
    for key in tree:
        if key not in known:
            raise InputError(f"{path}: {key} is not a known key; there are {', '.join(known)}")
    return tree


def _source_of(path: Path, tree: Mapping[str, Any]) -> Source:
    """The scenario that a file names, or has; names are of files beside it, or built in."""
    source = tree.get("scenario")
    if isinstance(source, str):
        return _beside(path, source)
    if isinstance(source, Mapping):
        base = source.get("scenario")
        if isinstance(base, str):
            return {**source, "scenario": _beside(path, base)}
        return source
    raise InputError(
        f"scenario is {source!r}, but must be the name of a scenario or of a file, or a table with "
        "the keys of one"
    )


def _beside(path: Path, name: str) -> str:
    if name in builtin_names():
        return name
    beside = path.parent / name
    return str(beside) if beside.exists() else name


def _varied(tree: Mapping[str, Any], name: str) -> dict[str, Values]:
    """The values of the keys that vary, which the file has as tables or as dotted texts."""
    table = tree.get(name)
    if not isinstance(table, Mapping):
        raise InputError(f"{name} is {table!r}, but must be a table of the keys that vary")
    varied: dict[str, Values] = {}
    for key, each in _flat(table, ""):
        if key in varied:
            raise InputError(
                f"{name}: '{key}' in quotes and {key} without set the same value; give one"
            )
        varied[key] = _values_of(f"{name}.{key}", each)
    return varied


def _flat(table: Mapping[str, Any], prefix: str) -> list[tuple[str, Any]]:
    pairs: list[tuple[str, Any]] = []
    for key, value in table.items():
        inner = isinstance(value, Mapping) and not {*value} & {*_RANGE, *DISTRIBUTIONS}
        # An empty table has no keys within: it is refused as a value.
        nested = value and inner
        pairs += _flat(value, f"{prefix}{key}.") if nested else [(f"{prefix}{key}", value)]
    return pairs


def _values_of(name: str, value: Any) -> Values:
    """A list, a range or a distribution as a file writes them. Raises `InputError`."""
    if isinstance(value, list):
        return value
    if isinstance(value, Mapping):
        if {*value} <= {*_RANGE} and {"from", "to", "count"} <= {*value}:
            return _range(name, value)
        (kind, bounds), *others = value.items() or [("", ())]
        if kind in DISTRIBUTIONS and not others and isinstance(bounds, list) and len(bounds) == 2:
            return _bounded(name, kind, bounds)
    kinds = ", ".join(f"{{ {kind} = [LOW, HIGH] }}" for kind in DISTRIBUTIONS)
    raise InputError(
        f"{name} is {value!r}, but must be a list of values, "
        f"{{ from = LOW, to = HIGH, count = N }}, or one of {kinds}"
    )


def _bounded(name: str, kind: str, bounds: Sequence[Any]) -> Distribution:
    """A distribution of a key. Raises `InputError` with the key for bounds that are none."""
    try:
        return DISTRIBUTIONS[kind](*bounds)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _range(name: str, value: Mapping[str, Any]) -> list[float]:
    """So many values from one to another, both included, their logarithms evenly with `log`."""
    ends = value["from"], value["to"]
    bounds = _bounded(name, "uniform", ends)
    count = value["count"]
    if not isinstance(count, int) or not 2 <= count <= 10_000:
        raise InputError(f"{name}.count is {count!r}, but must be a whole number, 2 to 10,000")
    log = value.get("log", False)
    if not isinstance(log, bool):
        raise InputError(f"{name}.log is {log!r}, but must be true or false")
    if log:
        bounds = _bounded(name, "log_uniform", ends)
    # Rounded, so that 0.3 is 0.3.
    return [float(f"{bounds.at(share):.12g}") for share in np.linspace(0.0, 1.0, count).tolist()]


def measures_of(path: Path, listed: Any) -> list[Measure]:
    """Measures as a file names them. Raises `InputError`."""
    if not isinstance(listed, list) or not all(isinstance(each, str) for each in listed):
        raise InputError(f"{path}: measures is {listed!r}, but must be a list of names")
    return [measure_named(each, path.parent) for each in listed]


def _program_of(path: Path, tree: Mapping[str, Any]) -> FileFunction | None:
    """The program that a file names as `FILE.py:FUNCTION`. Raises `InputError`."""
    text = tree.get("program")
    if text is None:
        return None
    measure = measure_named(text, path.parent) if isinstance(text, str) else text
    if not isinstance(measure, FileFunction):
        raise InputError(f"program is {text!r}, but must be 'FILE.py:FUNCTION'")
    return measure


def _plots(path: Path, listed: Any, design: Design) -> tuple[Plot, ...]:
    """The pictures that a file asks for. Raises `InputError` before any run."""
    if not isinstance(listed, list) or not all(isinstance(each, Mapping) for each in listed):
        raise InputError(f"{path}: plot is {listed!r}, but must be a list of tables, [[plot]]")
    plots: list[Plot] = []
    for each in listed:
        if not {"file"} <= {*each} <= {"file", "measure", "over"}:
            raise InputError(
                f"{path}: plot {dict(each)!r} must have file, and may have measure, over"
            )
        file, measure, over = (each.get(key) for key in ("file", "measure", "over"))
        _check_file(path, file, [plot.file for plot in plots])
        measures = [name_of(each) for each in design.measures]
        _check_choice(path, f"measure of {file}", [] if measure is None else [measure], measures)
        _check_choice(path, f"over of {file}", [] if over is None else over, design.parameters)
        plots.append(Plot(file, measure, None if over is None else tuple(over)))
    return tuple(plots)


def _check_file(path: Path, file: Any, taken: Sequence[str]) -> None:
    """Raises `InputError` for a name that no picture of a sweep has."""
    if not isinstance(file, str) or not file or Path(file).name != file:
        raise InputError(f"{path}: plot.file is {file!r}, but must be a name such as 'slip.png'")
    if file in taken:
        raise InputError(f"{path}: plot.file is {file!r} twice; give each picture its own")
    try:
        form_of(Path(file))
    except PictureFormatError as error:
        raise InputError(f"{path}: plot.file is {file!r}: {error}") from None


def _check_choice(path: Path, name: str, given: Any, known: Sequence[str]) -> None:
    """Raises `InputError` for names in a plot that the sweep does not have."""
    if not isinstance(given, list) or not all(each in known for each in given):
        raise InputError(
            f"{path}: plot: {name} is {given!r}, but the sweep has {', '.join(known) or 'none'}"
        )
