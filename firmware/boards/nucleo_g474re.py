"""NUCLEO-G474RE (STM32G474, 170 MHz); pins as in the wiring table of firmware/README.md."""

from machine import ADC, CAN, Pin

from boards.stm32 import BITRATE, Stm32Board, Wheel, encoder, pulses
from mdms_cell import speed_loop

PWM_SOURCE_HZ = 170_000_000
SENSORS = ("B0", "B1", "B2", "B12", "B13")


def board(folder="/flash"):
    """The board with both wheels off; `start` brings it to life."""
    channels, steps = pulses(2, PWM_SOURCE_HZ, (Pin("A0"), Pin("A1")))
    wheel_1 = Wheel(
        0,
        encoder=encoder(3, Pin("A6"), Pin("A7")),
        pulse=channels[0],
        steps=steps,
        phase=Pin("B4", Pin.OUT, value=0),
        current=ADC(Pin("C0")),
    )
    wheel_2 = Wheel(
        speed_loop.AXIS,
        encoder=encoder(4, Pin("B6"), Pin("B7")),
        pulse=channels[1],
        steps=steps,
        phase=Pin("B5", Pin.OUT, value=0),
        current=ADC(Pin("C1")),
    )
    return Stm32Board(
        CAN(1, BITRATE),
        (wheel_1, wheel_2),
        wake=Pin("C8", Pin.OUT, value=0),
        fault=Pin("C9", Pin.IN, Pin.PULL_UP),
        sensors=[Pin(name, Pin.IN, Pin.PULL_UP) for name in SENSORS],
        supply=ADC(Pin("C2")),
        run_led=Pin("A5", Pin.OUT, value=0),
        error_led=Pin("C6", Pin.OUT, value=0),
        folder=folder,
    )


def held():
    """Whether the user button is pressed, which keeps the firmware from starting."""
    return bool(Pin("C13", Pin.IN).value())
