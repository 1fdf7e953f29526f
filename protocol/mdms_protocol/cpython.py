"""Stand-ins on CPython for what MicroPython's compiler understands: they change nothing."""

from collections.abc import Callable
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])


def const(value: int) -> int:
    """Return `value`; MicroPython folds it into the code that uses it."""
    return value


class micropython:  # noqa: N801 - it stands in for the module of this name
    """The decorators of MicroPython's code emitters."""

    @staticmethod
    def native(function: _Function) -> _Function:
        """Return `function`; MicroPython compiles it to machine code."""
        return function

    viper = native


class ptr32(list[int]):  # noqa: N801 - viper's own name
    """The type of a buffer of 32-bit integers in a viper function's annotation."""


class ptr8(bytearray):  # noqa: N801 - viper's own name
    """The type of a buffer of bytes in a viper function's annotation."""


class ptr16(list[int]):  # noqa: N801 - viper's own name
    """The type of a buffer of 16-bit integers, not negative, in a viper function's annotation."""
