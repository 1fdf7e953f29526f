"""PYBv1.1 (STM32F405, 168 MHz); pins as in the wiring table of firmware/README.md."""

from machine import ADC, CAN, Pin

from boards.stm32 import BITRATE, Stm32Board, Wheel, encoder, pulses
from mdms_cell import speed_loop

#: Timers on APB1 count at 84 MHz.
PWM_SOURCE_HZ = 84_000_000
SENSORS = ("X1", "X2", "X3", "X4", "X6")


def board(folder="/flash"):
    """The board with both wheels off; `start` brings it to life."""
    channels, steps = pulses(12, PWM_SOURCE_HZ, (Pin("Y7"), Pin("Y8")))
    wheel_1 = Wheel(
        0,
        encoder=encoder(4, Pin("X9"), Pin("X10")),
        pulse=channels[0],
        steps=steps,
        phase=Pin("X7", Pin.OUT, value=0),
        current=ADC(Pin("X19")),
    )
    wheel_2 = Wheel(
        speed_loop.AXIS,
        encoder=encoder(8, Pin("Y1"), Pin("Y2")),
        pulse=channels[1],
        steps=steps,
        phase=Pin("X8", Pin.OUT, value=0),
        current=ADC(Pin("X20")),
    )
    return Stm32Board(
        CAN(1, BITRATE),
        (wheel_1, wheel_2),
        wake=Pin("Y5", Pin.OUT, value=0),
        fault=Pin("X11", Pin.IN, Pin.PULL_UP),
        sensors=[Pin(name, Pin.IN, Pin.PULL_UP) for name in SENSORS],
        supply=ADC(Pin("X21")),
        run_led=Pin("A14", Pin.OUT, value=0),
        error_led=Pin("A13", Pin.OUT, value=0),
        folder=folder,
    )


def held():
    """Whether the user button is pressed, which keeps the firmware from starting."""
    return not Pin("B3", Pin.IN, Pin.PULL_UP).value()
