"""STM32 boards: timers of `pyb` for PWM, encoders and tick, bxCAN or FDCAN."""

import time
from collections import namedtuple

import machine
import stm
from machine import (
    ADC,
    CAN,
    Pin,
    mem32,  # pyright: ignore[reportAttributeAccessIssue] - not in the stubs
)
from pyb import Timer

from boards.bus import BITRATE, BUS_OFF_MS, SAMPLE_POINT, Bus
from boards.can_filters import bxcan
from boards.cell_board import CellBoard
from boards.wheel import PWM_HZ, Wheel
from mdms_cell.drive import speed_loop

#: Timers that can count an encoder, by name.
_TIMERS = {3: stm.TIM3, 4: stm.TIM4, 8: stm.TIM8}
#: The fields IC1F and IC2F of a timer's CCMR1 (STM32 reference manuals): a level counts after eight
#: samples, 32 ticks of the timer apart. That is 1 us at 240 MHz and 3 us at 84 MHz, and so less
#: than the shortest pulse of an encoder.
_LONGEST = 0b1111
_INPUT_FILTERS = _LONGEST << 4 | _LONGEST << 12

#: The wiring of a board, by the names of its pins. `pwm_timer` counts at `pwm_hz` and has its
#: channels 1 and 2 at `pulses`; `encoders` has timer, A and B of each; `filters` is the
#: controller's function of `can_filters`, `receive` the pin of CAN RX; the rest see `CellBoard`.
Pins = namedtuple(
    "Pins",
    (
        "pwm_timer",
        "pwm_hz",
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
        "filters",
        "receive",
    ),
)


class Stm32Board(CellBoard):
    """A board with one of the STM32s that MicroPython's `machine.CAN` supports."""

    def __init__(self, pins: Pins, memory, number):
        self._timer = None
        super().__init__(pins, memory, number)

    def wheels(self, pins: Pins):
        """Both wheels, with the PWM of one timer."""
        channels, steps = pulses(pins.pwm_timer, pins.pwm_hz, [Pin(name) for name in pins.pulses])
        made = []
        for number in range(speed_loop.AXES):
            timer, pin_a, pin_b = pins.encoders[number]
            wheel = Wheel(
                number * speed_loop.AXIS,
                count=encoder(timer, Pin(pin_a), Pin(pin_b)).counter,
                set_width=channels[number].pulse_width,
                steps=steps,
                phase=Pin(pins.phases[number], Pin.OUT, value=0),
                current=ADC(Pin(pins.currents[number])),
            )
            made.append(wheel)
        return made[0], made[1]

    def connected(self, pins: Pins):
        """The bus."""
        return Stm32Bus(pins, self.registers)

    def start_tick(self, tick):
        """Begin to call `tick` every millisecond, from a hard interrupt."""
        self._timer = Timer(7, freq=speed_loop.TICK_HZ, callback=tick)

    def stop_tick(self):
        """End that, if it has begun."""
        if self._timer is not None:
            self._timer.callback(None)


class Stm32Bus(Bus):
    """The bus by a bxCAN or an FDCAN."""

    def __init__(self, pins: Pins, registers):
        self._pins = pins
        self._receive = Pin(pins.receive)  # its level only: the controller sets it up
        # One interrupt of an FDCAN may tell of several frames that have gone, and MicroPython frees
        # the buffer of one. The others would count as full, and their identifiers be refused.
        super().__init__(opened(), registers, tells_gone=pins.filters is not bxcan)

    def filters(self, identifiers):
        """Filters that let these identifiers through, all into the first FIFO."""
        return self._pins.filters(identifiers)

    def rearm(self):
        """Arm the interrupt, which only a frame that is taken does else.

        An FDCAN's interrupt also comes for a frame that was taken while it ran before.
        """
        self._arm(self._triggers)

    def transmit(self, can_id, data):
        """Give a frame to the controller, with no interrupt in between.

        MicroPython notes the mailbox only after it has begun to send. An interrupt could empty the
        mailbox before that. Then MicroPython would keep the mailbox for full, and the cell would be
        mute sooner or later.
        """
        interrupts = machine.disable_irq()
        try:
            return self._can.send(can_id, data)
        finally:
            machine.enable_irq(interrupts)

    def may_restart(self) -> bool:
        """Whether the bus is recessive: a bxCAN waits in `restart` until it is.

        Should it become dominant for good in that very moment, the watchdog ends the wait.
        """
        return self._receive.value() == 1


def opened():
    """The CAN controller; a bxCAN starts on a bus that falls silent, and is waited for."""
    while True:
        try:
            return CAN(1, BITRATE, sample_point=SAMPLE_POINT)
        except OSError:
            time.sleep_ms(BUS_OFF_MS)


def pulses(timer, source_hz, pins):
    """PWM channels 1 and 2 of a timer at `PWM_HZ`, one a pin, and their full width."""
    steps = source_hz // PWM_HZ
    pwm = Timer(timer, prescaler=0, period=steps - 1)
    channels = [
        pwm.channel(place + 1, Timer.PWM, pin=pins[place], pulse_width=0)
        for place in range(len(pins))
    ]
    return channels, steps


def encoder(timer, pin_a, pin_b):
    """A timer that counts the edges of a quadrature encoder, modulo 2**16, and no spikes."""
    counter = Timer(timer, prescaler=0, period=0xFFFF)
    counter.channel(1, Timer.ENC_AB, pin=pin_a)
    counter.channel(2, Timer.ENC_AB, pin=pin_b)
    # `pyb` leaves the inputs without a filter, each time that it sets up a channel.
    mem32[_TIMERS[timer] + stm.TIM_CCMR1] |= _INPUT_FILTERS
    return counter
