"""Teensy 4.1 (i.MX RT1062, 600 MHz): FlexPWM, quadrature decoders, a soft timer, FlexCAN.

Pins are those of the wiring table of docs/boards.md.
"""

from collections import namedtuple

import machine
from machine import ADC, CAN, PWM, Encoder, Pin, Timer

from boards import flash
from boards.bus import BITRATE, Bus
from boards.can_filters import shared
from boards.cell_board import CellBoard
from boards.wheel import PWM_HZ, Wheel
from mdms_cell.drive import speed_loop
from mdms_protocol.codecs import update

#: The wiring of a board, by the names of its pins. `pulses` are of FlexPWM channels A or B of
#: different submodules, `encoders` has A and B of each, which the crossbar reaches; the rest see
#: `CellBoard`.
Pins = namedtuple(
    "Pins",
    (
        "pulses",
        "phases",
        "encoders",
        "currents",
        "wake",
        "fault",
        "sensors",
        "place",
        "supply",
        "run_led",
        "error_led",
    ),
)

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

_FULL_WIDTH = 0xFFFF
#: Where in a bit it is read [%]. CiA 301 wants 87.5, where a FlexCAN at 40 MHz would have one time
#: quantum behind it; it needs two.
_SAMPLE_POINT = 85
#: Filters with masks of their own; the others share a mask that MicroPython does not set.
_FILTER_PLACES = 32
#: Place of the frames lost in `CAN.get_counters`.
_OVERRUNS = 7


def board():
    """The board with both wheels off; `start` brings it to life."""
    return TeensyBoard(PINS, _memory, update.TEENSY41)


def _memory(asleep):
    return flash.memory("/flash", asleep)


def held():
    """Whether D32 is wired to ground, which keeps the firmware from starting; it has no button."""
    return not Pin("D32", Pin.IN, Pin.PULL_UP).value()


class TeensyBoard(CellBoard):
    """The board, whose MicroPython has `machine.CAN` and `machine.Encoder`."""

    #: The least that the chip's watchdog can wait.
    WATCHDOG_MS = 500

    def __init__(self, pins: Pins, memory, number):
        self._timer = None
        super().__init__(pins, memory, number)

    def wheels(self, pins: Pins):
        """Both wheels."""
        made = []
        for number in range(speed_loop.AXES):
            pin_a, pin_b = pins.encoders[number]
            # Every edge counts, modulo 2**16: a longer count would be an object of its own.
            encoder = Encoder(number, Pin(pin_a), Pin(pin_b), phases=4, max=0xFFFF, min=0)
            wheel = Wheel(
                number * speed_loop.AXIS,
                count=encoder.value,
                set_width=PWM(Pin(pins.pulses[number]), freq=PWM_HZ, duty_u16=0).duty_u16,
                steps=_FULL_WIDTH,
                phase=Pin(pins.phases[number], Pin.OUT, value=0),
                current=ADC(Pin(pins.currents[number], Pin.IN)),
            )
            made.append(wheel)
        return made[0], made[1]

    def connected(self, pins: Pins):
        """The bus."""
        return FlexCanBus(CAN(1, BITRATE, sample_point=_SAMPLE_POINT), self.registers)

    def start_tick(self, tick):
        """Begin to call `tick` every millisecond, from a hard interrupt."""
        self._timer = Timer(
            -1, mode=Timer.PERIODIC, freq=speed_loop.TICK_HZ, callback=tick, hard=True
        )

    def stop_tick(self):
        """End that, if it has begun."""
        timer, self._timer = self._timer, None
        if timer is not None:
            timer.deinit()


class FlexCanBus(Bus):
    """The bus by a FlexCAN with one receive FIFO for six frames.

    Identifier 0 passes every filter, and so do extended frames with the leading bits of a filter.
    The cell drops them.
    """

    def __init__(self, can: CAN, registers):
        super().__init__(can, registers)
        self._overruns = 0

    def filters(self, identifiers):
        """Filters that let these identifiers through."""
        return [(can_id, mask, 0) for can_id, mask in shared(identifiers, _FILTER_PLACES)]

    def drop_sent(self):
        """Bus-off ends by itself, and all that waits in mailboxes would go out, beats of it."""
        self._can.restart()

    def service(self, now_ms):
        """See `Bus`; frames that were lost are in the controller's counters alone."""
        overruns = self._can.get_counters(self._counters)[_OVERRUNS]
        if overruns != self._overruns:
            interrupts = machine.disable_irq()  # the interrupt counts there too
            self.inbox.lose(max(overruns - self._overruns, 0))
            machine.enable_irq(interrupts)
            self._overruns = overruns
        super().service(now_ms)
