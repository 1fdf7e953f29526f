"""A cell's board as all boards have it: two wheels, bus, sensors, LEDs, watchdog, settings.

`stm32` has the parts of that port of MicroPython. The module of a board has its pins. The Teensy is
the only board of its port, so `teensy41` has both.
"""

import gc
import os
import sys
from array import array
from binascii import crc32

import machine
import micropython
from machine import ADC, WDT, Pin
from micropython import const

from boards.bus import WAIT_MS
from boards.wheel import CURRENT_TOO_LARGE_MA
from mdms_cell.drive import speed_loop
from mdms_protocol.codecs import update

#: The watchdog's patience while both bridges sleep, when flash may be written: that stops the
#: processor, on an STM32 for seconds.
WATCHDOG_ASLEEP_MS = 5_000
#: Largest slot, and the room that it leaves in the file system, and its image in the heap.
SLOT_MAX = const(256 * 1024)
_FLASH_LEFT = const(64 * 1024)
_HEAP_LEFT = const(128 * 1024)
#: Room for an exception in an interrupt, which cannot allocate its traceback.
EXCEPTION_BYTES = 100
#: 100 kOhm over 8.2 kOhm into an ADC of 3.3 V.
SUPPLY_FULL_SCALE_MV = const(43_544)

#: The bits of a place's number; the seventh jumper makes their number even.
_CODE = const(0x3F)
_NO_NODE = const(0xFF)

_SUPPLY_STEP_UV = const(SUPPLY_FULL_SCALE_MV * 1000 >> 12)


class CellBoard:
    """The board of a cell; see 'Cell and board' in DESIGN.md.

    Of `pins`, `wake` lets both bridges drive. `fault` is low while a bridge reports a fault.
    `sensors` are the five presence sensors, and `run_led` and `error_led` those of CiA 303-3.
    `place` are the inputs that jumpers in the table's connector pull low: six bits, the lowest
    first, and parity. The tick calls `sample(registers)` and `drive(registers)`. Importing touches
    nothing. A new board has both wheels off, and `start` brings it to life. `memory(asleep)` is
    called for the memory of the settings, and may return None. `slots` are those for firmware over
    the bus, if there are any. `number` is the board's own, see `mdms_protocol.codecs.update`.

    A family has `WATCHDOG_MS`, the watchdog's patience while a bridge is awake. It is far longer
    than a garbage collection. The family also makes the wheels, the bus and the tick's timer, by
    `wheels` and `connected`.
    """

    WATCHDOG_MS = 250

    slots = None
    bytecode = getattr(sys.implementation, "_mpy", 0) & update.BYTECODE

    def __init__(self, pins, memory, number=update.UNKNOWN_BOARD):
        self.number = number
        self._wake = Pin(pins.wake, Pin.OUT, value=0)
        self._wheels = self.wheels(pins)
        self.motors_off()
        self.registers = array("i", [0] * speed_loop.REGISTERS)
        # All of it counts: four of its bytes alone are the same on all chips of a lot.
        self.serial = crc32(machine.unique_id())
        # As an input without a pull: on an i.MX RT the pad's keeper would falsify the voltage.
        supply = ADC(Pin(pins.supply, Pin.IN))
        fault = Pin(pins.fault, Pin.IN, Pin.PULL_UP)
        self.sample = _sampling(supply, fault, self._wheels)
        self.drive = _driving(self._wake, self._wheels)
        self._sensors = _inputs(pins.sensors)
        self._place = _inputs(pins.place)
        self._run_led = Pin(pins.run_led, Pin.OUT, value=0)
        self._error_led = Pin(pins.error_led, Pin.OUT, value=0)
        self._blinking = False
        self.settings = memory(self.asleep)
        self._watchdog = None
        self._watchdog_ms = 0
        self.bus = self.connected(pins)
        self.inbox = self.bus.inbox
        self.service = self.bus.service
        self.send = self.bus.send
        self.listen = self.bus.listen
        self.transmit_errors = self.bus.transmit_errors
        self.receive_errors = self.bus.receive_errors

    # Defined by a chip family

    def wheels(self, pins):
        """Both wheels, made from the peripherals."""
        raise NotImplementedError

    def connected(self, pins):
        """The bus."""
        raise NotImplementedError

    def start_tick(self, tick):
        """Begin to call `tick` every millisecond, from a hard interrupt."""
        raise NotImplementedError

    def stop_tick(self):
        """End that, if it has begun."""
        raise NotImplementedError

    # Life

    def start(self, tick, watchdog=True):
        """Begin to call `tick` every millisecond and to receive; the watchdog cannot be stopped."""
        micropython.alloc_emergency_exception_buf(EXCEPTION_BYTES)
        self.bus.wait_ms = WAIT_MS
        self.bus.start()
        self.start_tick(tick)
        if watchdog:
            self._watchdog_ms = WATCHDOG_ASLEEP_MS
            self._watchdog = WDT(timeout=WATCHDOG_ASLEEP_MS)

    def stop(self):
        """End both interrupts, and the drive."""
        self.stop_tick()
        self.bus.stop()
        self.motors_off()

    def feed(self):
        """Feed the watchdog, and set its patience by whether a bridge is awake."""
        if self._watchdog is None:
            return
        wanted_ms = self.WATCHDOG_MS if self._wake.value() else WATCHDOG_ASLEEP_MS
        if self._watchdog_ms != wanted_ms:
            self._watchdog_ms = wanted_ms
            self._watchdog = WDT(timeout=wanted_ms)
        self._watchdog.feed()

    def wait_for_flash(self):
        """Have the watchdog wait while flash is written, though a bridge may still brake.

        The next `feed` ends that.
        """
        if self._watchdog is not None:
            self._watchdog_ms = WATCHDOG_ASLEEP_MS
            self._watchdog = WDT(timeout=WATCHDOG_ASLEEP_MS)
            self._watchdog.feed()

    # Called by the background

    @property
    def bus_off(self):
        """Whether the bus is off, or left alone after that."""
        return self.bus.off

    def asleep(self):
        """Whether both bridges sleep, so that flash may be written: no axis is on, none brakes.

        The next tick would come too late: it waits, with the voltage on, while flash is erased.
        """
        if not speed_loop.let_sleep(self.registers):
            return False
        self.motors_off()
        self._wake.low()
        self.feed()
        return True

    def presence(self):
        """The five presence bits; the sensors pull low where there is a parcel."""
        return _low(self._sensors)

    def place(self):
        """The node id that the table's connector says belongs here, 0 without any jumper.

        Jumpers are even in number. If one is missing or broken, this is the id of no node.
        """
        code = _low(self._place)
        odd = code ^ code >> 4
        odd ^= odd >> 2
        return _NO_NODE if (odd ^ odd >> 1) & 1 else code & _CODE

    def motors_off(self):
        """0 V on both motors at once, whatever state the program is in.

        Bridges that are awake brake, until a reset lets the pull-down put them to sleep.
        """
        for wheel in self._wheels:
            wheel.off()

    def blink(self, on):
        """Have both LEDs blink together, quickly, until it is ended: this is the board meant."""
        self._blinking = on

    def heap_free(self):
        """Bytes that are free in the heap, once garbage is collected."""
        gc.collect()
        return gc.mem_free()

    def flash_free(self):
        """Bytes that are free in the file system, 0 without one."""
        try:
            sizes = os.statvfs("/flash")
        except OSError:
            return 0
        return sizes[0] * sizes[3]

    def slots_room(self):
        """Bytes that a slot takes at most."""
        return max(min(SLOT_MAX, self.flash_free() - _FLASH_LEFT), 0)

    def image_room(self):
        """Bytes of the largest image that firmware can run from, beside the firmware itself."""
        return gc.mem_free() + gc.mem_alloc() - _HEAP_LEFT

    def restart(self):
        """Start the board anew, with the motors off."""
        self.stop()
        machine.reset()

    def show(self, now_ms, state, faulty):
        """Run LED on in operational, else blinking; error LED on at bus-off, blinking at faults."""
        if self._blinking:
            blink = now_ms // 80 & 1
            self._run_led.value(blink)
            self._error_led.value(blink)
            return
        blink = now_ms // 200 & 1
        self._run_led.value(1 if state == 5 else blink)
        self._error_led.value(1 if self.bus.off else blink if faulty else 0)


def _inputs(names):
    """Inputs that are high unless something pulls them low."""
    return [Pin(name, Pin.IN, Pin.PULL_UP) for name in names]


def _low(pins):
    """Which of the inputs are low, a bit each."""
    bits = 0
    for number in range(len(pins)):
        if not pins[number].value():
            bits |= 1 << number
    return bits


def _sampling(supply, fault, wheels):
    """Return a function that writes supply, currents and encoder counts into the registers.

    It writes the encoder counts last. The ADC belongs to the tick: an interrupted conversion would
    be of another channel. A bridge with a fault of its own has shut off, which counts as
    over-current.
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
    """Return a function that applies voltages; bridges wake while an axis is on or brakes."""

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
