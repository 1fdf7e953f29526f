"""MicroPython's own module, as far as the boards need it, on CPython."""

from mdms_protocol.compat import const

__all__ = ["alloc_emergency_exception_buf", "const", "native", "viper"]


def native(function):
    """Return `function`; MicroPython compiles it to machine code."""
    return function


viper = native


def alloc_emergency_exception_buf(_size):
    """CPython needs no room put aside for an exception."""
