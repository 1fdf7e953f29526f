"""What the STM32 boards share: CAN, two wheels, sensors, supply, LEDs, watchdog, flash.

A board's own module only tells its `Pins`.
"""

from array import array
from binascii import crc32
from collections import namedtuple

import machine
import micropython
from machine import ADC, CAN, WDT, Pin
from micropython import const
from pyb import Timer

from boards.wheel import CURRENT_TOO_LARGE_MA, Wheel, encoder, pulses
from mdms_cell.drive import speed_loop
from mdms_cell.queues import Inbox, Outbox

BITRATE = 1_000_000
#: The watchdog's patience while a bridge is awake: far more than a garbage collection.
WATCHDOG_MS = 250
#: And while both sleep, when flash may be written: erasing sectors stops the processor for seconds.
WATCHDOG_ASLEEP_MS = 5_000
#: How long the bus is left alone after bus-off.
BUS_OFF_MS = 100
#: 100 kOhm over 8.2 kOhm into an ADC of 3.3 V.
SUPPLY_FULL_SCALE_MV = const(43_544)

_SUPPLY_STEP_UV = const(SUPPLY_FULL_SCALE_MV * 1000 >> 12)

#: The wiring of a board, by the names of its pins. `pwm_timer` counts at `pwm_hz` and has its
#: channels 1 and 2 at `pulses`; `encoders` has timer, A and B of each; the rest see `Stm32Board`.
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
        "supply",
        "run_led",
        "error_led",
    ),
)


class Stm32Board:
    """The board of a cell; see 'Cell and board' in DESIGN.md.

    `wake` lets both bridges drive, `fault` is low while one of them reports a fault, `sensors` are
    the five presence sensors, `run_led` and `error_led` those of CiA 303-3. The tick calls
    `sample(registers)` and `drive(registers)`. `memory(asleep)` returns the memory of the settings,
    or None. Importing touches nothing; a board is made with both
    wheels off, and `start` brings it to life.
    """

    def __init__(self, pins: Pins, memory):
        self.registers = array("i", [0] * speed_loop.REGISTERS)
        # All of it counts: four of its bytes alone are the same on all chips of a lot.
        self.serial = crc32(machine.unique_id())
        self.inbox = Inbox()
        self.bus_off = False
        self._wake = Pin(pins.wake, Pin.OUT, value=0)
        self._wheels = wheels(pins)
        supply, fault = ADC(Pin(pins.supply)), Pin(pins.fault, Pin.IN, Pin.PULL_UP)
        self.sample = _sampling(supply, fault, self._wheels)
        self.drive = _driving(self._wake, self._wheels)
        self._sensors = [Pin(name, Pin.IN, Pin.PULL_UP) for name in pins.sensors]
        self._run_led = Pin(pins.run_led, Pin.OUT, value=0)
        self._error_led = Pin(pins.error_led, Pin.OUT, value=0)
        self.settings = memory(self.asleep)
        self._outbox = Outbox()
        self._can = CAN(1, BITRATE)
        self._flags = _no_flags
        self._timer = None
        self._watchdog = None
        self._watchdog_ms = 0
        self._bus_off_ms = 0
        self.motors_off()

    # Life

    def start(self, tick, watchdog=True):
        """Begin to call `tick` every millisecond and to receive; the watchdog cannot be stopped."""
        interrupt = self._can.irq(self._on_can, CAN.IRQ_RX | CAN.IRQ_STATE, True)
        self._flags = interrupt.flags  # pyright: ignore[reportAttributeAccessIssue] - other ports
        self._timer = Timer(7, freq=speed_loop.TICK_HZ, callback=tick)
        if watchdog:
            self._watchdog_ms = WATCHDOG_ASLEEP_MS
            self._watchdog = WDT(timeout=WATCHDOG_ASLEEP_MS)

    def stop(self):
        """End both interrupts, and the drive."""
        if self._timer is not None:
            self._timer.callback(None)
        self._can.irq(None, 0)
        self.motors_off()

    def feed(self):
        """Tell the watchdog that all is well."""
        if self._watchdog is None:
            return
        wanted_ms = WATCHDOG_MS if self._wake.value() else WATCHDOG_ASLEEP_MS
        if self._watchdog_ms != wanted_ms:
            self._watchdog_ms = wanted_ms
            self._watchdog = WDT(timeout=wanted_ms)
        self._watchdog.feed()

    # What interrupts call

    @micropython.native
    def _on_can(self, can: CAN):
        while self._flags() & CAN.IRQ_RX:  # pyright: ignore[reportCallIssue] - as above
            self.inbox.take(can)
        if can.state() == CAN.STATE_BUS_OFF:
            self.registers[speed_loop.CUT] = 1

    # What the background calls

    def service(self, now_ms):
        """Look after the bus, and send what waits."""
        self._look_after_bus(now_ms)
        if not self.bus_off:
            self._outbox.drain(self._transmit)

    def _look_after_bus(self, now_ms):
        if self._can.state() != CAN.STATE_BUS_OFF:
            self.bus_off = False
        elif not self.bus_off:
            self.bus_off = True
            self._bus_off_ms = now_ms
            self.registers[speed_loop.CUT] = 1
            self._outbox.clear()
        elif (now_ms - self._bus_off_ms) & 0x3FFFFFFF >= BUS_OFF_MS:
            self._bus_off_ms = now_ms
            self._can.restart()

    def asleep(self):
        """Whether both bridges sleep, so that flash may be written: no axis is on, none brakes.

        The next tick would come too late: it waits, with the voltage on, while flash is erased.
        """
        registers = self.registers
        for base in (0, speed_loop.AXIS):
            standing = registers[base + speed_loop.SIGNS] & speed_loop.STANDING
            braking = registers[speed_loop.AWAKE] and not standing
            if registers[base + speed_loop.MODE] or braking:
                return False
        self.motors_off()
        self._wake.low()
        self.feed()
        return True

    def presence(self):
        """The five presence bits; the sensors pull low where there is a parcel."""
        bits = 0
        for place in range(len(self._sensors)):
            if not self._sensors[place].value():
                bits |= 1 << place
        return bits

    def send(self, can_id, data):
        """Queue a frame; False when there is no room."""
        if not self._outbox.push(can_id, data):
            return False
        if not self.bus_off:
            self._outbox.drain(self._transmit)
        return True

    def _transmit(self, can_id, data):
        """Give a frame to the controller, with no interrupt in between.

        MicroPython notes the mailbox only when it has begun to send. One that an interrupt lets
        run empty before that would be taken for good, and the cell be mute sooner or later.
        """
        interrupts = machine.disable_irq()
        try:
            return self._can.send(can_id, data)
        finally:
            machine.enable_irq(interrupts)

    def listen(self, identifiers):
        """Let frames with these identifiers through, and as few others as there are filters for."""
        from boards.can_filters import filters

        self._can.set_filters(filters(identifiers))

    def motors_off(self):
        """0 V on both motors at once, whatever state the program is in.

        Bridges that are awake brake, until a reset lets the pull-down put them to sleep.
        """
        for wheel in self._wheels:
            wheel.off()

    def show(self, now_ms, state, faulty):
        """Run LED on in operational, else blinking; error LED on at bus-off, blinking at faults."""
        blink = now_ms // 200 & 1
        self._run_led.value(1 if state == 5 else blink)
        self._error_led.value(1 if self.bus_off else blink if faulty else 0)


def _no_flags() -> int:
    """What the CAN interrupt is for before there is one."""
    return 0


def _sampling(supply, fault, wheels):
    """What writes supply, currents and encoder counts into the registers, those last.

    The ADC belongs to the tick: a conversion that another interrupts tells of its channel.
    A bridge with a fault of its own has shut off; that counts as over-current.
    """

    @micropython.native
    def sample(  # noqa: PLR0917 - see `boards.wheel`
        registers,
        read_supply=supply.read_u16,
        no_fault=fault.value,
        sense_1=wheels[0].sense,
        sense_2=wheels[1].sense,
        count_1=wheels[0].count,
        count_2=wheels[1].count,
    ):
        registers[speed_loop.SUPPLY] = (read_supply() >> 4) * _SUPPLY_STEP_UV
        sense_1(registers)
        sense_2(registers)
        if not no_fault():
            registers[speed_loop.CURRENT] = CURRENT_TOO_LARGE_MA
            registers[speed_loop.AXIS + speed_loop.CURRENT] = CURRENT_TOO_LARGE_MA
        registers[speed_loop.COUNT] = count_1() & 0xFFFF
        registers[speed_loop.AXIS + speed_loop.COUNT] = count_2() & 0xFFFF

    return sample


def _driving(wake, wheels):
    """What applies the voltages; the bridges are awake while an axis is on or brakes."""

    @micropython.native
    def drive(
        registers,
        drive_1=wheels[0].drive,
        drive_2=wheels[1].drive,
        awake=wake.high,
        asleep=wake.low,
    ):
        drive_1(registers)
        drive_2(registers)
        if registers[speed_loop.AWAKE]:
            awake()
        else:
            asleep()

    return drive


def wheels(pins: Pins) -> "tuple[Wheel, Wheel]":
    """Both wheels of a board, made from its peripherals."""
    channels, steps = pulses(pins.pwm_timer, pins.pwm_hz, [Pin(name) for name in pins.pulses])
    made = []
    for number in range(speed_loop.AXES):
        timer, pin_a, pin_b = pins.encoders[number]
        wheel = Wheel(
            number * speed_loop.AXIS,
            encoder=encoder(timer, Pin(pin_a), Pin(pin_b)),
            pulse=channels[number],
            steps=steps,
            phase=Pin(pins.phases[number], Pin.OUT, value=0),
            current=ADC(Pin(pins.currents[number])),
        )
        made.append(wheel)
    return made[0], made[1]
