"""Which board this is."""


def board_module(machine):
    """The module of the board that MicroPython calls `machine`; RuntimeError without one."""
    if "Teensy 4.1" in machine:
        from boards import teensy41 as module
    elif "WEACTSTUDIO_MINI_STM32H743" in machine:
        from boards import weact_h743 as module
    elif "PYBv1.1" in machine:
        from boards import pybv11 as module
    elif "G474" in machine:
        from boards import nucleo_g474re as module
    else:
        raise RuntimeError("there is no board module for " + machine)
    return module
