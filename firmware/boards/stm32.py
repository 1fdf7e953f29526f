"""What the STM32 boards share: CAN, two wheels, sensors, supply, LEDs, watchdog, flash.

Everything is made from the peripherals that a board's own module picks; nothing here knows a pin.
"""

from array import array

import machine
import micropython
from machine import ADC, CAN, WDT, Pin
from micropython import const
from pyb import Timer

from boards.flash import Settings
from mdms_cell import speed_loop
from mdms_cell.inbox import Inbox
from mdms_cell.outbox import Outbox

BITRATE = 1_000_000
#: The watchdog's patience: far more than a garbage collection.
WATCHDOG_MS = 250
#: How long the bus is left alone after bus-off.
BUS_OFF_MS = 100
PWM_HZ = 20_000
#: DRV8874 carrier: 1.1 V/A into an ADC of 3.3 V.
CURRENT_FULL_SCALE_MA = 3_000
#: 100 kOhm over 8.2 kOhm into an ADC of 3.3 V.
SUPPLY_FULL_SCALE_MV = 43_544
FILTERS_MAX = 14

_SATURATED = const(64_000)
_SUPPLY_MIN_UV = const(1_000_000)


class Wheel:
    """Bridge (phase and enable), encoder and current sense of the axis whose registers are at base.

    `pulse` is a PWM channel whose full width is `steps`.
    """

    def __init__(self, base: int, *, encoder: Timer, pulse, steps: int, phase: Pin, current: ADC):
        self._encoder = encoder
        self._pulse = pulse
        self._steps = steps
        self._phase = phase
        self._current = current
        self._count = base + speed_loop.COUNT
        self._current_ma = base + speed_loop.CURRENT
        self._voltage = base + speed_loop.VOLTAGE

    @micropython.native
    def sample(self, registers):
        """Write the encoder's count into the registers."""
        registers[self._count] = self._encoder.counter() & 0xFFFF

    @micropython.native
    def drive(self, registers):
        """Set phase and pulse width to the voltage in the registers."""
        voltage_uv = registers[self._voltage]
        if voltage_uv < 0:
            self._phase.low()
            voltage_uv = -voltage_uv
        else:
            self._phase.high()
        width = (voltage_uv >> 12) * self._steps // (registers[speed_loop.SUPPLY] >> 12)
        self._pulse.pulse_width(min(width, self._steps))

    def sense(self, registers):
        """Write the motor's current into the registers, signed as the voltage.

        A reading at its upper end counts twice, so that it is over any limit.
        """
        reading = self._current.read_u16()
        current_ma = reading * CURRENT_FULL_SCALE_MA >> 16
        if reading > _SATURATED:
            current_ma = 2 * CURRENT_FULL_SCALE_MA
        if registers[self._voltage] < 0:
            current_ma = -current_ma
        registers[self._current_ma] = current_ma

    def off(self):
        """No pulse."""
        self._pulse.pulse_width(0)


class Stm32Board:
    """The board of a cell; see 'Cell and board' in DESIGN.md.

    `wake` lets both bridges drive, `fault` is low while one of them reports a fault, `sensors` are
    the five presence sensors, `run_led` and `error_led` those of CiA 303-3.
    """

    def __init__(
        self,
        can: CAN,
        wheels: tuple[Wheel, Wheel],
        *,
        wake: Pin,
        fault: Pin,
        sensors: list[Pin],
        supply: ADC,
        run_led: Pin,
        error_led: Pin,
        folder: str,
    ):
        self.registers = array("i", [0] * speed_loop.REGISTERS)
        self.serial = int.from_bytes(machine.unique_id()[-4:], "little")
        self.settings = Settings(folder)
        self.inbox = Inbox()
        self.bus_off = False
        self._outbox = Outbox()
        self._can = can
        self._wheels = wheels
        self._wake = wake
        self._fault = fault
        self._sensors = sensors
        self._supply = supply
        self._run_led = run_led
        self._error_led = error_led
        self._timer = None
        self._watchdog = None
        self._bus_off_ms = 0
        self.motors_off()

    # Life

    def start(self, tick, watchdog=True):
        """Begin to call `tick` every millisecond and to receive; the watchdog cannot be stopped."""
        self._can.irq(self._on_can, CAN.IRQ_RX | CAN.IRQ_STATE, True)
        self._timer = Timer(7, freq=speed_loop.TICK_HZ, callback=tick)
        if watchdog:
            self._watchdog = WDT(timeout=WATCHDOG_MS)

    def stop(self):
        """End both interrupts, and the drive."""
        if self._timer is not None:
            self._timer.callback(None)
        self._can.irq(None, 0)
        self.motors_off()

    def feed(self):
        """Tell the watchdog that all is well."""
        if self._watchdog is not None:
            self._watchdog.feed()

    # What interrupts call

    @micropython.native
    def sample(self, registers):
        """Write the encoder counts into the registers."""
        self._wheels[0].sample(registers)
        self._wheels[1].sample(registers)

    @micropython.native
    def drive(self, registers):
        """Apply the voltages; the bridges sleep while both axes are off."""
        self._wheels[0].drive(registers)
        self._wheels[1].drive(registers)
        modes = registers[speed_loop.MODE] | registers[speed_loop.AXIS + speed_loop.MODE]
        if modes and not registers[speed_loop.CUT]:
            self._wake.high()
        else:
            self._wake.low()

    def _on_can(self, can: CAN):
        self.inbox.fill(can)
        if can.state() == CAN.STATE_BUS_OFF:
            self.registers[speed_loop.CUT] = 1

    # What the background calls

    def service(self, now_ms):
        """Send what waits, look after the bus, read currents and supply."""
        self._look_after_bus(now_ms)
        if not self.bus_off:
            self._outbox.drain(self._can)
        for wheel in self._wheels:
            wheel.sense(self.registers)
        if not self._fault.value():
            self._report_bridge_fault()
        supply_uv = (self._supply.read_u16() * SUPPLY_FULL_SCALE_MV >> 16) * 1000
        self.registers[speed_loop.SUPPLY] = max(supply_uv, _SUPPLY_MIN_UV)

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

    def _report_bridge_fault(self):
        """A bridge with a fault of its own has shut off; that counts as over-current."""
        for base in (0, speed_loop.AXIS):
            self.registers[base + speed_loop.CURRENT] = 2 * CURRENT_FULL_SCALE_MA

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
            self._outbox.drain(self._can)
        return True

    def listen(self, identifiers):
        """Let frames with these identifiers through; all, where there are too many for filters."""
        if len(identifiers) > FILTERS_MAX:
            self._can.set_filters(None)
        else:
            self._can.set_filters([(can_id, 0x7FF, 0) for can_id in identifiers])

    def motors_off(self):
        """Cut the drive at once, whatever state the program is in."""
        self._wake.low()
        for wheel in self._wheels:
            wheel.off()

    def show(self, now_ms, state, faulty):
        """Run LED on in operational, else blinking; error LED on at bus-off, blinking at faults."""
        blink = now_ms // 200 & 1
        self._run_led.value(1 if state == 5 else blink)
        self._error_led.value(1 if self.bus_off else blink if faulty else 0)


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
    """A timer that counts the edges of a quadrature encoder, modulo 2**16."""
    counter = Timer(timer, prescaler=0, period=0xFFFF)
    counter.channel(1, Timer.ENC_AB, pin=pin_a)
    counter.channel(2, Timer.ENC_AB, pin=pin_b)
    return counter
