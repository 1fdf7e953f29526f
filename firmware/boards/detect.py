"""Which board this is."""

import sys

#: What MicroPython calls a board, in part (`sys.implementation._machine`), and its module here.
MODULES = (
    ("Teensy 4.1", "teensy41"),
    ("WEACTSTUDIO_MINI_STM32H743", "weact_h743"),
    ("PYBv1.1", "pybv11"),
    ("G474", "nucleo_g474re"),
)


def module_name(machine):
    """The name of the module for what MicroPython calls the board; RuntimeError without one."""
    for part, name in MODULES:
        if part in machine:
            return name
    raise RuntimeError("there is no board module for " + machine)


def board_module():
    """The module of the board that this runs on."""
    name = module_name(sys.implementation._machine)
    return getattr(__import__("boards." + name), name)
