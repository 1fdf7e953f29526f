"""Compilation of inner loops: once per machine, kept beside the source."""

import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])
Stamp = tuple[str, int, int]

OWN_IMPORT = re.compile(r"^from (mdms_\w+(?:\.\w+)*) import", re.MULTILINE)


def compiled(function: Function) -> Function:
    """The function compiled by numba at its first call, cached on disk, its type unchanged."""
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    dispatcher = numba.njit(cache=True, error_model="numpy")(function)
    # A compiled function holds copies of those it calls, but numba looks for changes in its own
    # file only; without this it would run old code after a change in another module.
    index = dispatcher._cache._cache_file  # type: ignore[attr-defined]
    index._source_stamp = (index._source_stamp, sorted(stamps(function.__module__)))
    return cast(Function, dispatcher)


@cache
def stamps(module: str) -> frozenset[Stamp]:
    """Name, time and size of a module of ours and of all that it imports of ours."""
    path = Path(sys.modules[module].__file__ or "")
    state = path.stat()
    found = frozenset({(module, state.st_mtime_ns, state.st_size)})
    return found.union(*map(stamps, OWN_IMPORT.findall(path.read_text("utf-8"))))
