"""Stand-ins on CPython for what MicroPython's compiler understands: they change nothing."""


def const(value):
    """Return `value`; MicroPython folds it into the code that uses it."""
    return value


class micropython:  # noqa: N801 - it stands in for the module of this name
    """The decorators of MicroPython's code emitters."""

    @staticmethod
    def native(function):
        """Return `function`; MicroPython compiles it to machine code."""
        return function

    viper = native


class ptr32(list):  # noqa: N801 - viper's own name
    """The type of a buffer of 32-bit integers in a viper function's annotation."""


class ptr8(bytearray):  # noqa: N801 - viper's own name
    """The type of a buffer of bytes in a viper function's annotation."""
