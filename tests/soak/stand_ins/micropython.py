"""MicroPython's own module, as far as the boards need it, on CPython."""

from mdms_cell.cpython import const

__all__ = ["const", "native", "viper"]


def native(function):
    """Return `function`; MicroPython compiles it to machine code."""
    return function


viper = native
