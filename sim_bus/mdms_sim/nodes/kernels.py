"""Quick functions for simulated cells, in place of functions of the firmware with equal results.

Kernels are compiled: the functions that viper turns into machine code on a board. As on a board,
numbers that do not fit a buffer lose their upper bits, and no index is checked. Entries of the
dictionary are looked up once for all cells, because every cell has the same table.
"""

import sys
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

# All modules of a cell are imported with it.
from mdms_cell import cell as _cell  # noqa: F401
from mdms_cell.canopen import objects
from mdms_cell.drive import speed_loop
from mdms_model.compiled import compiled

KERNEL_PACKAGES = ("mdms_cell.", "mdms_protocol.")

_plain_find = objects.find
_shared_find = cache(objects.find)
_PLAIN: dict[Callable[..., Any], Callable[..., Any]] = {}


def quicken_cells() -> None:
    """Have all cells of this process call the quick functions from now on.

    A kernel is compiled at its first call. Its results are those of the plain function. The speed
    loop stays as it is, because no Python object calls it.
    """
    for module_name in [name for name in sys.modules if name.startswith(KERNEL_PACKAGES)]:
        names = vars(sys.modules[module_name])
        for name, value in tuple(names.items()):
            if isinstance(value, FunctionType) and getattr(value, "is_kernel", False):
                names[name] = value if value is speed_loop.step else _kernel(value)
            elif value is _plain_find:
                names[name] = _shared_find


def plain(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The function of the firmware that a kernel has been compiled from; itself for any other."""
    return _PLAIN.get(kernel, kernel)


@cache
def _kernel(function: FunctionType) -> Callable[..., Any]:
    """The compiled function; it calls compiled ones, whatever its module has in their place."""
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        called = names.get(name)
        if isinstance(called, FunctionType) and getattr(called, "is_kernel", False):
            names[name] = _kernel(called)
    own = FunctionType(function.__code__, names, function.__name__, function.__defaults__)
    own.__module__, own.__qualname__ = function.__module__, function.__qualname__
    kernel: Callable[..., Any] = compiled(own)
    _PLAIN[kernel] = function
    return kernel
