"""WeAct MiniSTM32H743 (STM32H743, 480 MHz); pins as in the wiring table of docs/boards.md.

They leave USB, both flash chips, the SD card and the display's connector alone; the camera's
connector must be free.
"""

from machine import Pin

from boards import can_filters, flash
from boards.stm32 import Pins, Stm32Board
from mdms_protocol.codecs import update

PINS = Pins(
    pwm_timer=2,
    pwm_hz=240_000_000,  # of timers on APB1
    pulses=("A0", "A1"),
    phases=("D14", "D15"),
    encoders=((3, "A6", "A7"), (8, "C6", "C7")),
    currents=("C4", "C5"),
    wake="D8",
    fault="D9",
    sensors=("E7", "E8", "E9", "E15", "B12"),
    place=("D0", "D1", "D3", "D5", "E0", "E1", "A8"),
    supply="B1",
    run_led="E3",
    error_led="B13",
    filters=can_filters.fdcan_h7,
    receive="B8",
)


def board():
    """The board with both wheels off; `start` brings it to life."""
    return Stm32Board(PINS, _memory, update.WEACT_H743)


def _memory(asleep):
    return flash.memory("/flash", asleep)


def held():
    """Whether the button K1 is pressed, which keeps the firmware from starting."""
    return bool(Pin("C13", Pin.IN, Pin.PULL_DOWN).value())
