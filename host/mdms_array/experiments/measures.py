"""Measures: numbers that an experiment takes from a run, by name or by a function of the user."""

import copyreg
import dis
import hashlib
import inspect
import math
import runpy
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from functools import cache, cached_property
from math import pi
from pathlib import Path
from types import CodeType, MappingProxyType
from typing import Any

import numpy as np

from mdms_array.run import Run
from mdms_host.motion.outcome import GoalOutcome
from mdms_model.arrays import Floats
from mdms_model.errors import InputError
from mdms_model.scenario.scenario import Cell

#: Whole numbers of a table are below.
MOST_WHOLE = 1 << 63
#: Sums and squares of numbers within this have room in a float, and so has an axis.
MOST = 1e100
Measure = str | Callable[[Run], Any]
#: In place of the names of a run's own: any name or number, and any number.
ITEM, NUMBER = "NAME", "NUMBER"
#: The measures of a sweep that names none.
USUAL = ("reached", "time_s", "position_error_m", "slipping_share", "violations")


def reached(run: Run) -> bool:
    """Whether the run ended well; an endless job ends well at its time limit."""
    return run.status == "reached" or (run.status == "time limit" and run.endless)


def time_s(run: Run) -> float:
    """When the last parcel came to its goal to stay, or the program ended [s].

    A run that did not end well has its time limit: its time is censored there.
    """
    if not reached(run):
        return run.scenario.run.duration_s
    arrivals = [each.outcome.time_s for each in run.parcels.values() if each.outcome is not None]
    return max((each for each in arrivals if each is not None), default=run.duration_s)


def position_error_m(run: Run) -> float | None:
    """Largest distance of a parcel from its goal at the end, in truth [m]."""
    return _largest(
        each.outcome.position_error_m for each in run.parcels.values() if each.outcome is not None
    )


def yaw_error_rad(run: Run) -> float | None:
    """Largest angle of a parcel from its goal at the end, in truth [rad]."""
    return _largest(
        each.outcome.yaw_error_rad for each in run.parcels.values() if each.outcome is not None
    )


def belief_position_error_m(run: Run) -> float | None:
    """Largest distance of the host's belief from the truth at the end [m].

    Parcels of one kind are alike, so their names do not count.
    """
    return _largest(np.hypot(miss[0], miss[1]) for miss in _belief_misses(run))


def belief_yaw_error_rad(run: Run) -> float | None:
    """Largest angle of the host's belief from the truth at the end [rad]; not of discs."""
    return _largest((miss[2] + pi) % (2.0 * pi) - pi for miss in _belief_misses(run, turned=True))


def slipping_share(run: Run) -> float:
    """Share of wheel contacts in motion that slipped."""
    return float(run.figures["slipping_share"])


def energy_j(run: Run) -> float:
    """Energy that the motors took from the supply [J], by samples and nominal constants.

    Power that a motor gives back is not counted.
    """
    record, cell = run.record, run.scenario.cell
    if run.scenario.run.fidelity != "firmware":
        # The paper's motors have no bridges.
        cell = replace(cell, current_limit_a=None)
    power_w = motor_power_w(cell, record.voltage_v, record.speed_m_s)
    # A voltage is unknown where no wheel was driven.
    power_w = np.nan_to_num(np.maximum(power_w, 0.0)).sum(axis=1)
    return float(np.trapezoid(power_w, record.time_s))


def motor_power_w(cell: Cell, voltage_v: Floats, speed_m_s: Floats) -> Floats:
    """Electrical power of motors by voltage and surface speed of the wheels (eqs 7 and 8) [W]."""
    constant_vs_per_m = cell.torque_constant_nm_per_a * cell.gear_ratio / cell.wheel_radius_m
    back_emf_v = constant_vs_per_m * speed_m_s
    limit_a = np.inf if cell.current_limit_a is None else cell.current_limit_a
    current_a = np.clip((voltage_v - back_emf_v) / cell.resistance_ohm, -limit_a, limit_a)
    # A bridge that limits lowers its voltage.
    power: Floats = current_a * (back_emf_v + current_a * cell.resistance_ohm)
    return power


def bus_load(run: Run) -> float | None:
    """Share of time that the busiest bus was not idle; None without a bus."""
    return None if run.bus is None else run.bus.load


def bus_errors(run: Run) -> int | None:
    """Errors on all buses; None without a bus."""
    return None if run.bus is None else run.bus.errors


def violations(run: Run) -> int:
    """How many violations the referee has noted."""
    return len(run.violations)


def incidents(run: Run) -> int:
    """How many incidents the host has noted."""
    return len(run.incidents)


def lost_cells(run: Run) -> int:
    """How many cells the host does without at the end."""
    return len(run.lost_cells)


def parcels_per_hour(run: Run) -> float | None:
    """Throughput of a stream; None without one."""
    return None if "stream" not in run.figures else float(run.figures["stream"]["parcels_per_hour"])


def _largest(values: Any) -> float | None:
    """The largest magnitude; None where any is unknown, or there is none."""
    listed = list(values)
    if not listed or any(value is None for value in listed):
        return None
    return float(max(map(abs, listed)))


def _belief_misses(run: Run, *, turned: bool = False) -> list[Floats]:
    """Belief less truth at the end; with `turned` of parcels alone whose turn can be seen.

    Parcels of one kind are alike, and their names the host's guess: its beliefs count for those of
    the kind that lie nearest, each for one.
    """
    # It is an extra.
    from scipy.optimize import linear_sum_assignment

    kinds: dict[str, list[str]] = {}
    for parcel in run.scenario.parcel:
        if not (turned and parcel.shape == "disc"):
            kinds.setdefault(parcel.kind or f"only {parcel.name}", []).append(parcel.name)
    misses: list[Floats] = []
    for names in kinds.values():
        runs = [run.parcels[name] for name in names]
        believed = [each.believed_pose for each in runs if each.believed_pose is not None]
        true = [each.true_pose for each in runs if each.true_pose is not None]
        if believed and true:
            away = np.array(believed)[:, None] - np.array(true)
            misses += [*away[linear_sum_assignment(np.hypot(away[..., 0], away[..., 1]))]]
    return misses


NAMED: Mapping[str, Callable[[Run], Any]] = {
    each.__name__: each
    for each in (
        *(reached, time_s, position_error_m, yaw_error_rad),
        *(belief_position_error_m, belief_yaw_error_rad, slipping_share, energy_j),
        *(bus_load, bus_errors, violations, incidents, lost_cells, parcels_per_hour),
    )
}


@dataclass(frozen=True, slots=True)
class FileFunction:
    """A function of a Python file, by its name; every worker reads the file once."""

    path: str
    name: str

    @property
    def function(self) -> Callable[..., Any]:
        """The function itself. Raises `InputError`."""
        found = _names_of(self.path).get(self.name)
        if not callable(found):
            raise InputError(f"{self.path}: has no function {self.name!r}")
        function: Callable[..., Any] = found
        return function

    @property
    def __name__(self) -> str:
        return self.name

    def __call__(self, *arguments: Any) -> Any:
        """Call it."""
        return self.function(*arguments)


@cache
def _names_of(path: str) -> dict[str, Any]:
    folder = str(Path(path).parent)
    if folder not in sys.path:
        # As for a script: it imports what lies beside it.
        sys.path.insert(0, folder)
    try:
        return runpy.run_path(path, run_name="mdms measures")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (Exception, SystemExit) as error:
        raise InputError(f"{path}: {type(error).__name__}: {error}") from error


def measure_named(text: str, folder: Path) -> Measure:
    """A measure as files name it: a name, a path into the figures, or `FILE.py:FUNCTION`."""
    file, colon, name = text.partition(":")
    if not colon:
        return text
    return FileFunction(str((folder / file).resolve()), name)


def name_of(measure: Measure) -> str:
    """The name of a measure's column. Raises `InputError` for a callable without a name."""
    name = measure if isinstance(measure, str) else getattr(measure, "__name__", None)
    if name is None:
        raise InputError(f"{measure!r:.80} has no name; write a function with `def` around it")
    return str(name)


def check_measures(measures: Sequence[Measure]) -> tuple[Measure, ...]:
    """The measures.

    Raises `InputError` for an unknown name, two with one name, a lambda, or an `async def`.
    """
    if not isinstance(measures, str | Sequence) and not callable(measures):
        raise InputError(f"measures is {measures!r}, but must be a list of names and functions")
    listed = (measures,) if isinstance(measures, str) or callable(measures) else tuple(measures)
    for each in listed:
        function = each.function if isinstance(each, FileFunction) else each
        if inspect.iscoroutinefunction(function):
            raise InputError(
                f"measures: {name_of(each)} is an `async def`, but nothing awaits it; write a "
                "plain `def`, which gets a run that has ended"
            )
        if isinstance(each, FileFunction):
            continue
        if isinstance(each, str):
            if each not in NAMED:
                _check_path(each)
        elif not callable(each) or inspect.ismethod(each) or "<" in _path_of(each):
            raise InputError(
                f"measures: {each!r} cannot be sent to a worker; define a function by `def` "
                "outside all others"
            )
        else:
            _ = identity_of(each)
    names = [name_of(each) for each in listed]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InputError(f"measures: {', '.join(sorted(twice))} stands there twice")
    return listed


def _check_path(path: str) -> None:
    """Raises `InputError` for text that is no path to a figure that a run may have."""
    if "." not in path:
        raise InputError(
            f"measures: {path!r} is unknown; there are {', '.join(NAMED)}, paths into the "
            "figures of `mdms simulate --json` such as parcels.0.x_m, and functions"
        )
    known: Any = known_figures()
    above = "a run"
    for place, part in enumerate(parts := path.split("."), 1):
        if known is None:
            raise InputError(f"measures: {path}: {above} is one figure, with no {part!r} inside")
        if part in known:
            known = known[part]
        elif (ITEM in known and part) or (NUMBER in known and part.isdecimal()):
            known = next(iter(known.values()))
        else:
            names = get_close_matches(part, known, n=3) or [*known]
            raise InputError(
                f"measures: {path}: {above} has no {part!r}; there are {', '.join(names)}"
            )
        above = ".".join(parts[:place])
    if known is not None:
        raise InputError(
            f"measures: {path} has more than one figure; add one of {', '.join(known)}"
        )


@cache
def known_figures() -> Mapping[str, Any]:
    """The names of all figures that a simulated run may have, as tables; None is a figure."""
    # They are of the simulator, which takes its time to import.
    from mdms_array.figures import POSE, TWIST
    from mdms_sim.referee.rules import Violation
    from mdms_sim.simulation import BusFigures

    def table(*names: str, **inner: Any) -> dict[str, Any]:
        return dict.fromkeys(names) | inner

    def members(kind: Any) -> dict[str, Any]:
        return table(*(each.name for each in fields(kind)))

    stream = "came", "left", "wrong", "touches", "lasts_s", "parcels_per_hour"
    parcel = table("name", *POSE, *TWIST, "at_rest", "lifted", estimate=table(*POSE))
    return table(
        *("title", "fidelity", "nodes", "seed", "duration_s", "wall_s", "compile_s"),
        *("real_time_factor", "status", "reason", "fault", "slipping_share", "pauses"),
        parcels={ITEM: parcel},
        goals={ITEM: members(GoalOutcome)},
        stream=table(*stream, by_exit={ITEM: None}),
        bus=members(BusFigures),
        lost_cells={NUMBER: None},
        violations={NUMBER: members(Violation)},
    )


def _path_of(function: Any) -> str:
    """The path of a function in its module; a function within another has a < in it."""
    return str(getattr(function, "__qualname__", "<"))


def identity_of(function: Any) -> str:
    """The identity of a measure or a program: a name, and a digest of its source.

    That of a file is its whole text. That of a function is its own text and all that it uses of its
    module: functions, classes and values, with those of defaults and closures. Raises `InputError`
    for a value that nobody can compare with that of an earlier run.
    """
    if function is None or isinstance(function, str):
        return str(function)
    if isinstance(function, FileFunction):
        source = Path(function.path).read_bytes()
    else:
        source = "\0".join(_Used(function).texts).encode()
    return f"{name_of(function)}:{hashlib.sha256(source).hexdigest()}"


class _Used:
    """The texts of a function, and of all of its module that it uses, directly or not."""

    def __init__(self, function: Any) -> None:
        self.texts: list[str] = []
        self._name, self._module = name_of(function), function.__module__
        self._known: set[int] = set()
        self._above: list[int] = []
        self._waiting: list[Any] = []
        self._add(self._name, function)
        while self._waiting:
            user = self._waiting.pop(0)
            inside = _inside_class(user) if inspect.isclass(user) else _inside_function(user)
            for name, value in inside.items():
                self._add(f"{user.__qualname__}: {name}", value)

    def _add(self, name: str, value: Any) -> None:
        try:
            self.texts.append(f"{name} = {self._text(value)}")
        except (TypeError, ValueError, RecursionError) as error:
            raise InputError(
                f"{self._name} uses {name}, a value that cannot be compared with that of an "
                f"earlier run ({error}); make it within the function"
            ) from None

    def _text(self, value: Any) -> str:
        """A text that is equal for equal values, in all processes. Raises TypeError."""
        if value is None or type(value) in (bool, int, float, complex, str, bytes):
            return repr(value)
        if inspect.ismodule(value):
            return f"module {value.__name__}"
        if id(value) in self._above:
            return f"{len(self._above) - self._above.index(id(value))} above"
        self._above.append(id(value))
        try:
            return self._text_of_object(value)
        finally:
            self._above.pop()

    def _text_of_object(self, value: Any) -> str:
        if callable(value):
            value = inspect.unwrap(value, stop=self._is_own)
        owner = getattr(value, "__self__", None)
        if inspect.isroutine(value) and owner is not None and not inspect.ismodule(owner):
            return self._text((value.__name__, owner))
        if inspect.isroutine(value) or inspect.isclass(value):
            return self._text_of_code(value)
        kind = type(value)
        if kind in (list, tuple, set, frozenset):
            texts = [self._text(each) for each in value]
            in_order = texts if kind in (list, tuple) else sorted(texts)
            return f"{kind.__name__}({', '.join(in_order)})"
        if kind in (dict, MappingProxyType):
            return self._text(["dict", *value.items()])
        if kind is np.ndarray and not value.dtype.hasobject:
            digest = hashlib.sha256(value.tobytes()).hexdigest()
            return f"array({value.dtype.descr}, {value.shape}, {digest})"
        # Of any other object, all that pickle would keep.
        reduced = copyreg.dispatch_table.get(kind)
        parts = reduced(value) if reduced else value.__reduce_ex__(4)
        listed = [parts] if isinstance(parts, str) else [*parts]
        return self._text([list(each) if isinstance(each, Iterator) else each for each in listed])

    def _text_of_code(self, value: Any) -> str:
        """The name of a function or a class; those of the module wait to be looked into."""
        name = f"{getattr(value, '__module__', None)}.{value.__qualname__}"
        own_class = inspect.isclass(value) and value.__module__ == self._module
        if (own_class or self._is_own(value)) and id(value) not in self._known:
            self._known.add(id(value))
            self.texts.append(_source(value))
            self._waiting.append(value)
        return name

    def _is_own(self, value: Any) -> bool:
        """Whether a function was written in the module: a decorator may be of another."""
        return inspect.isfunction(value) and value.__globals__.get("__name__") == self._module


def _inside_function(function: Any) -> dict[str, Any]:
    """Values that a function uses: defaults, its closure and globals."""
    closure = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    names = sorted({*_globals_in(function.__code__)} & {*function.__globals__})
    return {
        "defaults": (function.__defaults__, function.__kwdefaults__),
        **{name: cell.cell_contents for name, cell in closure},
        **{name: function.__globals__[name] for name in names},
    }


def _inside_class(kind: Any) -> dict[str, Any]:
    """Values that a class uses: its bases, its functions, and values but those that Python adds."""
    inside: dict[str, Any] = {"bases": kind.__bases__}
    for name, value in vars(kind).items():
        if isinstance(value, property):
            inside[name] = value.fget, value.fset
        elif isinstance(value, cached_property):
            inside[name] = value.func
        elif inspect.isfunction(value) or not name.startswith(("__", "_abc_")):
            inside[name] = value
    return inside


def _globals_in(code: CodeType) -> Iterator[str]:
    """The names of globals that a function, or one within it, uses."""
    for each in dis.get_instructions(code):
        if each.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            yield each.argval
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _globals_in(each)


def _source(user: Any) -> str:
    """The text of a function or a class; the code of a lambda, and of a function of no file."""
    code = getattr(user, "__code__", None)
    if code is not None and code.co_name == "<lambda>":
        # Two may stand in a line.
        return _code_text(code)
    try:
        return inspect.getsource(code or user)
    except (OSError, TypeError):
        return "" if code is None else _code_text(code)


def _code_text(code: CodeType) -> str:
    inner = [_code_text(each) if isinstance(each, CodeType) else each for each in code.co_consts]
    return repr((code.co_code, code.co_names, inner))


def measured(run: Run, measure: Measure) -> bool | int | float | str | None:
    """The value of a measure. Raises the errors of a function, and `InputError` otherwise."""
    if isinstance(measure, str):
        value = NAMED[measure](run) if measure in NAMED else _figure(run.figures, measure)
    else:
        value = measure(run)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and math.isnan(value):
        return None
    if isinstance(value, float) and math.isinf(value):
        raise InputError(
            f"measure {name_of(measure)} gave {value}, of which there is no mean; give a finite "
            "number, or None for a run without a value"
        )
    if isinstance(value, float) and abs(value) > MOST:
        raise InputError(
            f"measure {name_of(measure)} gave {value}, but at most {MOST:g} has a mean and an "
            "axis; give it in another unit"
        )
    if isinstance(value, str):
        return utf8(value)
    if isinstance(value, int) and not -MOST_WHOLE <= value < MOST_WHOLE:
        raise InputError(
            f"measure {name_of(measure)} gave a whole number of {value.bit_length()} bits and a "
            "sign, but a table has 64 in all; give a float"
        )
    if value is None or isinstance(value, bool | int | float):
        return value
    raise InputError(
        f"measure {name_of(measure)} gave {type(value).__name__}, but must give a number, text, "
        "true, false or None"
    )


def utf8(text: str) -> str:
    """The text as a table may have it: code points without UTF-8 become escapes."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _figure(figures: Any, path: str) -> Any:
    """A figure by its path, parcels by number or by name; None where the run has none."""
    for part in path.split("."):
        if isinstance(figures, Mapping):
            figures = figures.get(part)
        elif not isinstance(figures, list | tuple):
            return None
        elif part.isdecimal():
            figures = figures[int(part)] if int(part) < len(figures) else None
        else:
            named = (each for each in figures if part in (each.get("name"), each.get("parcel")))
            figures = next(named, None)
    return figures
