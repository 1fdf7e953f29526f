"""PYBv1.1 (STM32F405, 168 MHz); pins as in the wiring table of docs/boards.md."""

from machine import Pin

from boards import can_filters, sectors
from boards.stm32 import Pins, Stm32Board
from mdms_protocol.codecs import update

PINS = Pins(
    pwm_timer=12,
    pwm_hz=84_000_000,  # of timers on APB1
    pulses=("Y7", "Y8"),
    phases=("X7", "X8"),
    encoders=((4, "X9", "X10"), (8, "Y1", "Y2")),
    currents=("X19", "X20"),
    wake="Y5",
    fault="X11",
    sensors=("X1", "X2", "X3", "X4", "X6"),
    place=("X5", "X12", "Y6", "Y9", "Y10", "Y11", "Y12"),
    supply="X21",
    run_led="A14",
    error_led="A13",
    filters=can_filters.bxcan,
    receive="Y3",
)
#: Behind sectors 1 and 2 (16 KB each) with the file system: sectors 3 (16 KB) and 4 (64 KB).
STORAGE = sectors.Storage(address=0x08004000, banks=(0x8000, 0xC000))


def board():
    """The board with both wheels off; `start` brings it to life."""
    return Stm32Board(PINS, _memory, update.PYBV11)


def _memory(asleep):
    return sectors.Sectors(STORAGE, asleep)


def make_room():
    """Make the file system smaller, which erases it, so that settings can be saved."""
    sectors.make_room(STORAGE)


def held():
    """Whether the user button is pressed, which keeps the firmware from starting."""
    return not Pin("B3", Pin.IN, Pin.PULL_UP).value()
