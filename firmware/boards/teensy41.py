"""Teensy 4.1 (i.MX RT1062, 600 MHz); pins as in the wiring table of docs/boards.md."""

from machine import Pin

from boards import flash
from boards.mimxrt import MimxrtBoard, Pins
from mdms_protocol.update import codes

PINS = Pins(
    pulses=("D5", "D6"),
    phases=("D4", "D9"),
    encoders=(("D2", "D3"), ("D7", "D8")),
    currents=("D14", "D15"),
    wake="D10",
    fault="D11",
    sensors=("D33", "D34", "D35", "D36", "D37"),
    place=("D26", "D27", "D28", "D29", "D30", "D31", "D24"),
    supply="D16",
    run_led="D13",
    error_led="D12",
)


def board():
    """The board with both wheels off; `start` brings it to life."""
    return MimxrtBoard(PINS, _memory, codes.TEENSY41)


def _memory(asleep):
    return flash.memory("/flash", asleep)


def held():
    """Whether D32 is wired to ground, which keeps the firmware from starting; it has no button."""
    return not Pin("D32", Pin.IN, Pin.PULL_UP).value()
