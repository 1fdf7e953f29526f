"""How viper code reads signed numbers, and buffers that are not among its arguments.

On a 64-bit machine viper loads a negative number from a buffer of 32-bit integers as a large
positive one; shifting it up and down again by `WIDEN` bits repairs that, and by 0 bits does nothing
where it is not needed.

`ptr8(buffer)` in viper code is the place of the buffer's bytes. Where the same code is not viper,
it is the buffer itself, by the functions here.
"""

import sys

try:
    from typing import TYPE_CHECKING
except ImportError:
    TYPE_CHECKING = False  # type: ignore[misc]
if TYPE_CHECKING:
    from typing import Any

WIDEN = 32 if sys.maxsize >> 32 and sys.implementation.name == "micropython" else 0


def ptr8(buffer: "Any") -> "Any":
    """A buffer of bytes."""
    return buffer


#: Of numbers of 16 bits, not negative, and of 32.
ptr16 = ptr32 = ptr8
