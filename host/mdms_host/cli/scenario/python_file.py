"""Programs that people write in Python: a file with `SCENARIO` and `async def main(table)`."""

import inspect
import runpy
from pathlib import Path
from typing import Any

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.programs.program import Main

_SUFFIX = ".py"


def is_python(name_or_path: str) -> bool:
    """Whether a program is named that is a file of Python."""
    return name_or_path.endswith(_SUFFIX)


def main_of_file(name_or_path: str) -> Main | None:
    """The `main` of a file of Python; None for anything else. Raises `CommandError`."""
    if not is_python(name_or_path):
        return None
    main = _names(name_or_path).get("main")
    if not inspect.iscoroutinefunction(main):
        raise _wrong(name_or_path, "has no `async def main(table)`")
    return main


def scenario_of_file(name_or_path: str) -> str:
    """The scenario that a file of Python names: built in, or a file beside it.

    Raises `CommandError`.
    """
    named = _names(name_or_path).get("SCENARIO")
    if not isinstance(named, str):
        raise _wrong(name_or_path, "has no SCENARIO, the name of a scenario or of its file")
    beside = Path(name_or_path).parent / named
    return str(beside) if beside.exists() else named


def _names(path: str) -> dict[str, Any]:
    try:
        return runpy.run_path(path, run_name="mdms program")
    except OSError as error:
        raise _wrong(path, f"cannot be read: {error.strerror}") from None
    except SyntaxError as error:
        raise _wrong(path, f"line {error.lineno}: {error.msg}") from None
    except Exception as error:
        raise _wrong(path, f"{type(error).__name__}: {error}") from error


def _wrong(path: str, what: str) -> CommandError:
    return CommandError(f"{path}: {what}", Exit.USAGE)
