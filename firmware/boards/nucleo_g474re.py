"""NUCLEO-G474RE (STM32G474, 170 MHz); pins as in the wiring table of docs/boards.md.

It saves no settings. Flash of an STM32G4 has error correction. If an erase or a program operation
is cut off, a later read of that flash raises the NMI. The NMI comes again until FLASH_ECCR is
cleared, and MicroPython's handler does not clear it. So a board whose power failed during a save
would hang at every start.
"""

from machine import Pin

from boards import can_filters
from boards.stm32 import Pins, Stm32Board
from mdms_protocol.codecs import update

PINS = Pins(
    pwm_timer=2,
    pwm_hz=170_000_000,
    pulses=("A0", "A1"),
    phases=("B4", "B5"),
    encoders=((3, "A6", "A7"), (4, "B6", "B7")),
    currents=("C0", "C1"),
    wake="C8",
    fault="C9",
    sensors=("B0", "B1", "B2", "B12", "B13"),
    place=("B10", "B11", "B14", "B15", "C10", "C11", "C12"),
    supply="C2",
    run_led="LED1",  # PA5; as "A5" the board knows PC0
    error_led="C6",
    filters=can_filters.fdcan,
    receive="A11",
)


def board():
    """The board with both wheels off; `start` brings it to life."""
    return Stm32Board(PINS, _no_memory, update.NUCLEO_G474RE)


def _no_memory(_asleep):
    return None


def held():
    """Whether the user button is pressed, which keeps the firmware from starting."""
    return bool(Pin("C13", Pin.IN).value())
