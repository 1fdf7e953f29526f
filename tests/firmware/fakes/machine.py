"""The part of `machine` that the boards use, as MicroPython 1.29 documents it."""

import sys

import world
from can_bx import BxCan
from pin_names import found


class Micropython:
    """MicroPython's own module, with the functions that the unix port leaves out of it."""

    def __init__(self, module):
        self._module = module

    def __getattr__(self, name):
        return getattr(self._module, name)

    def alloc_emergency_exception_buf(self, size):
        """Make room for an exception that an interrupt raises."""
        world.told.append(("exception buffer", size))


if sys.implementation.name == "micropython":
    import micropython

    sys.modules["micropython"] = Micropython(micropython)


def unique_id():
    """The serial number of this very chip."""
    return bytes(range(12))


def reset():
    """The immediate effect on a board: nothing of the program goes on."""
    world.told.append("reset")


def disable_irq():
    """Keep interrupts waiting; returns whether they waited before."""
    before, world.interrupts_off = world.interrupts_off, True
    return before


def enable_irq(before):
    """Let interrupts be as they were; those that waited run now."""
    world.interrupts_off = before
    for bus in world.buses:
        bus.serve()


class Pin:
    """A pin whose level stands in `world.levels`; it goes by one name alone here."""

    IN = 0
    OUT = 1
    PULL_UP = 1
    PULL_DOWN = 2

    def __init__(self, name, mode=-1, pull=-1, value=None):
        if world.board is not None:
            pin = found(world.board, name)
            assert world.names.setdefault(pin, name) == name, (pin, world.names[pin], name)
        self.name = name
        self.mode = mode
        self.output = mode == Pin.OUT
        if value is not None:
            world.levels[name] = value
        elif mode != -1 and name not in world.levels:
            world.levels[name] = 1 if pull == Pin.PULL_UP else 0

    def value(self, level=None):
        """Read the level, or set it."""
        if level is None:
            return world.levels[self.name]
        assert self.output, self.name
        world.levels[self.name] = level
        return None

    def high(self):
        """Set the level to 1."""
        self.value(1)

    def low(self):
        """Set the level to 0."""
        self.value(0)


class ADC:
    """An input whose reading stands in `world.analog`.

    The port for the i.MX RT sets up no pad, and the reset value of a pad has its keeper on.
    """

    def __init__(self, pin):
        assert pin.mode == Pin.IN or world.board != "teensy41", "the pad's keeper is on"
        self.name = pin.name

    def read_u16(self):
        """The reading."""
        world.conversions += 1
        return world.analog.get(self.name, 0)


class WDT:
    """Remembers when it was fed; a pause longer than the timeout would have been a reset."""

    def __init__(self, timeout=5000):
        world.told.append(("watchdog", timeout))
        self.timeout = timeout
        world.fed_ms = world.now_ms

    def feed(self):
        """Begin a new period."""
        assert world.now_ms - world.fed_ms <= self.timeout, "the watchdog has reset the board"
        world.fed_ms = world.now_ms


class Memory16:
    """Half words by their addresses; only flash lies there, blank where the bench has none."""

    def __getitem__(self, address):
        return 0xFFFF if world.flash is None else world.flash.half_word(address)


class Memory32:
    """Registers of peripherals that have been set up, by their addresses."""

    def __getitem__(self, address):
        return world.registers[address]

    def __setitem__(self, address, value):
        assert address in world.registers, "a peripheral without a clock takes nothing"
        world.registers[address] = value & 0xFFFFFFFF


mem16 = Memory16()
mem32 = Memory32()

#: That of a PYBv1.1; `bench` puts another board's in its place.
CAN = BxCan
