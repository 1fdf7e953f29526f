"""Compilation of inner loops: once per machine, kept beside the source."""

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """The function compiled by numba at its first call, cached on disk, its type unchanged."""
    return cast(Function, numba.njit(cache=True, error_model="numpy")(function))
