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


def read_program(path: str) -> tuple[str, Main]:
    """The scenario that a file of Python names, built in or a file beside it, and its `main`.

    The file is executed, once a call. Raises `CommandError`.
    """
    names = _names(path)
    named, main = names.get("SCENARIO"), names.get("main")
    if not isinstance(named, str):
        raise _wrong(path, "has no SCENARIO, the name of a scenario or of its file")
    if not inspect.iscoroutinefunction(main):
        raise _wrong(path, "has no `async def main(table)`")
    beside = Path(path).parent / named
    return str(beside) if beside.exists() else named, main


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
