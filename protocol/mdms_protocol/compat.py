"""Names that MicroPython's compiler understands, available on both interpreters.

On MicroPython `const` folds a number into the code that uses it, `micropython.native` and
`micropython.viper` compile a function to machine code, and `ptr8`, `ptr16` and `ptr32` are the
types of buffers in viper code: of bytes, of 16-bit numbers that are not negative, and of 32-bit
numbers. Where the same code is not viper they change nothing: `ptr8(buffer)` is the buffer itself.
"""
# mypy: disable-error-code="no-redef"

import sys

__all__ = ["WIDEN", "const", "micropython", "ptr8", "ptr16", "ptr32"]

try:
    import micropython  # type: ignore[import-not-found,unused-ignore]
    from micropython import const  # pyright: ignore[reportAssignmentType]
except ImportError:
    from collections.abc import Callable
    from typing import TypeVar

    _Function = TypeVar("_Function", bound="Callable[..., Any]")

    def const(value: int) -> int:
        """Return `value`."""
        return value

    class micropython:  # noqa: N801 - it stands in for the module of this name
        """The decorators of MicroPython's code emitters."""

        @staticmethod
        def native(function: _Function) -> _Function:
            """Return `function`."""
            return function

        @staticmethod
        def viper(function: _Function) -> _Function:
            """Return `function`, marked as a kernel; simulators may compile it in another way."""
            function.is_kernel = True  # type: ignore[attr-defined]
            return function


try:
    from typing import TYPE_CHECKING
except ImportError:
    TYPE_CHECKING = False  # type: ignore[misc]
if TYPE_CHECKING:
    from typing import Any

    class ptr8(bytearray):  # noqa: N801 - viper's own name
        """A buffer of bytes."""

    class ptr16(list[int]):  # noqa: N801 - viper's own name
        """A buffer of 16-bit numbers."""

    class ptr32(list[int]):  # noqa: N801 - viper's own name
        """A buffer of 32-bit numbers."""

else:

    def ptr8(buffer):
        """Return `buffer`."""
        return buffer

    ptr16 = ptr32 = ptr8

#: On a 64-bit machine viper loads a negative number from a buffer of 32-bit integers as a large
#: positive one; shifting it up and down again by so many bits repairs that, and by 0 bits does
#: nothing where it is not needed.
WIDEN = 32 if sys.maxsize >> 32 and sys.implementation.name == "micropython" else 0
