"""From a name, a file or a program in Python to a checked scenario and what to run on it."""

import atexit
import inspect
import runpy
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan
from numbers import Real
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, cast

from mdms_array.bus_load import refuse_overload
from mdms_array.checks import refuse_large_gain, refuse_pushless, refuse_tipping
from mdms_host.programs.program import Main
from mdms_model.errors import InputError
from mdms_model.run.folder import told_of_run
from mdms_model.scenario.file import load_scenario, scenario_from
from mdms_model.scenario.scenario import Scenario

_SUFFIX = ".py"
#: No run is longer, as a scenario's duration [s].
LONGEST_S = 1e5
#: Nor shorter: the first sample is taken at 0.
SHORTEST_S = 1e-3
#: A scenario: its built-in name, its file, its tables, or itself.
Source = str | Path | Mapping[str, Any] | Scenario


def open_program(name_or_path: str, overrides: Sequence[str]) -> tuple[Scenario, Main | None]:
    """A checked scenario that cells and bus can follow, and what to run on it but its own tasks.

    A file of Python has both. Raises `InputError`.
    """
    main = _main_of_run(name_or_path)
    if is_python(name_or_path):
        name_or_path, main = read_program(name_or_path)
        overrides = [*overrides, "motion.field=program"]
    return checked(load_scenario(name_or_path, overrides)), main


def _main_of_run(folder: str) -> Main | None:
    """The program in Python of an earlier run, None if it had none. Raises `InputError`."""
    told = told_of_run(folder)
    program = None if told is None else told[1].get("program")
    if program is None:
        return None
    if program.get("source") is None:
        raise _wrong(folder, f"its program {program['file']} was not kept, so nothing repeats it")
    function = program.get("function", "main")
    if function is None:
        raise _wrong(
            folder,
            f"its program was within a function of {program['file']} or had arguments bound to it, "
            "so nothing repeats it; give a function at the top of a file",
        )
    # It stays as long as the process: a folder of this run keeps it again, and errors name lines.
    kept = mkdtemp(prefix="mdms-")
    atexit.register(shutil.rmtree, kept, ignore_errors=True)
    path = Path(kept) / Path(program["file"]).name
    path.write_text(program["source"], "utf-8")
    return _function(_names(str(path)), function, f"{folder}: {path.name}")


def open_source(source: Source, main: Main | None = None) -> tuple[Scenario, Main | None]:
    """The same from a name, a file, a dict or a `Scenario`; `main` is a program to run on it.

    With a program the scenario's goals and tasks do not count. A folder of an earlier run has its
    own, unless another is given. Raises `InputError`.
    """
    if isinstance(source, str | Path) and is_python(str(source)):
        name, own = read_program(str(source))
        if main is not None:
            raise InputError(f"{source}: has a program of its own; give its scenario instead")
        source, main = name, own
    if isinstance(source, str | Path) and main is None:
        main = _main_of_run(str(source))
    scenario = scenario_of(source)
    if main is not None:
        check_program(main)
        scenario = _programmed(scenario)
    return checked(scenario), main


def scenario_of(source: Source) -> Scenario:
    """A scenario from a name, a file, a dict, or itself. Raises `InputError`."""
    if isinstance(source, Scenario):
        return source
    if isinstance(source, Mapping):
        return scenario_from(source)
    if isinstance(source, str | Path):
        return load_scenario(source)
    raise InputError(f"scenario: {source!r} is neither a name, a file, a dict nor a Scenario")


def check_program(main: object) -> None:
    """Raises `InputError` for any other object: a coroutine function that takes a table."""
    if not inspect.iscoroutinefunction(main):
        raise InputError(f"program: {main!r} is not `async def program(table)`")
    try:
        inspect.signature(main).bind("table")
    except TypeError as error:
        raise InputError(f"program: {main!r} does not take one table: {error}") from None


def check_time(name: str, time_s: object, least_s: float = 0.0) -> float:
    """A time that a caller gives [s]. Raises `InputError` for one that no run has."""
    number = float(time_s) if isinstance(time_s, Real) else nan
    # NaN is in no range.
    if not least_s <= number <= LONGEST_S:
        raise InputError(f"{name} is {time_s!r}, but must be {least_s:g} to {LONGEST_S:g} seconds")
    return number


def _programmed(scenario: Scenario) -> Scenario:
    """The scenario with nothing to do of its own."""
    if scenario.run.fidelity != "firmware":
        raise InputError(
            f"program: run.fidelity is {scenario.run.fidelity!r}, which has no cells for a program "
            "to steer with; set run.fidelity to 'firmware'"
        )
    motion = replace(scenario.motion, field="program")
    parcels = tuple(replace(parcel, goal=None) for parcel in scenario.parcel)
    return replace(scenario, motion=motion, parcel=parcels, task=())


def checked(scenario: Scenario) -> Scenario:
    """The scenario, once it is known that cells and bus can follow it. Raises `InputError`."""
    refuse_overload(scenario)
    refuse_pushless(scenario)
    refuse_large_gain(scenario)
    refuse_tipping(scenario)
    return scenario


def is_python(name_or_path: str) -> bool:
    """Whether a program is named that is a file of Python."""
    return name_or_path.endswith(_SUFFIX)


def read_program(path: str) -> tuple[str, Main]:
    """The scenario that a file of Python names, built in or a file beside it, and its `main`.

    The file is executed, once a call. Raises `InputError`.
    """
    names = _names(path)
    named = names.get("SCENARIO")
    if not isinstance(named, str):
        raise _wrong(path, "has no SCENARIO, the name of a scenario or of its file")
    main = _function(names, "main", path)
    beside = Path(path).parent / named
    return str(beside) if beside.exists() else named, main


def _function(names: Mapping[str, Any], name: str, path: str) -> Main:
    """The program of that name of a file. Raises `InputError`."""
    main = names.get(name)
    try:
        check_program(main)
    except InputError:
        raise _wrong(path, f"has no `async def {name}(table)`") from None
    return cast(Main, main)


def _names(path: str) -> dict[str, Any]:
    try:
        return runpy.run_path(path, run_name="mdms program")
    except OSError as error:
        raise _wrong(path, f"cannot be read: {error.strerror}") from None
    except SyntaxError as error:
        raise _wrong(path, f"line {error.lineno}: {error.msg}") from None
    except (Exception, SystemExit) as error:
        raise _wrong(path, f"{type(error).__name__}: {error}") from error


def _wrong(path: str, what: str) -> InputError:
    return InputError(f"{path}: {what}")
