"""All axes of a cell: commanded, stopped and watched together."""

from mdms_cell.drive import speed_loop
from mdms_cell.drive.axis import Axis
from mdms_cell.drive.state_machine import UNDERVOLTAGE
from mdms_protocol.codecs import cia402
from mdms_protocol.compat import const, micropython

_SWITCHED_ON = const(0x23)
assert _SWITCHED_ON == cia402.SWITCHED_ON
_DRIVING = (cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE, cia402.FAULT_REACTION)
_FAILED = (cia402.FAULT, cia402.FAULT_REACTION)


class Axes:
    """The axes over the registers; their faults go to `emcy`, from source 1 on."""

    def __init__(self, objects, registers, emcy):
        self._axes = [Axis(number, objects, registers) for number in range(speed_loop.AXES)]
        self._drives = [axis.drive for axis in self._axes]
        self._emcy = emcy
        #: Whether the neighbour layer leads the wheels, and targets from the bus count for nothing.
        self._led = False

    @property
    def led(self):
        """Whether the neighbour layer sets the targets; those from the bus are not taken then."""
        return self._led

    @led.setter
    def led(self, led):
        self._led = led
        for drive in self._drives:
            drive.led = led

    @micropython.native
    def lead(self, targets_um_s):
        """Set the targets of axes that the host has switched on, and enable them."""
        for axis, drive in enumerate(self._drives):
            if drive.state == _SWITCHED_ON:
                drive.control(cia402.ENABLE_OPERATION | _halt(drive))
            drive.set_target(targets_um_s[axis])

    def rest(self):
        """Take axes back to 'switched on': 0 V, and braked."""
        for drive in self._drives:
            if drive.state == cia402.OPERATION_ENABLED:
                drive.control(cia402.SWITCH_ON | _halt(drive))

    def load(self):
        """Take over the settings from the dictionary."""
        for axis in self._axes:
            axis.load()

    @micropython.native
    def poll(self):
        """Follow what the speed loop did.

        Too low a supply is reported in every state; it is a fault from 'switched on' on.
        """
        emcy = self._emcy
        source = 0
        for drive in self._drives:
            source += 1
            code = drive.poll()
            if code:
                emcy.report(source, code)
            elif drive.state in _FAILED:
                continue
            elif drive.lacks_supply():
                emcy.report(source, UNDERVOLTAGE)
            elif emcy.errors:
                emcy.clear(source)

    def driving(self):
        """Whether any motor is on."""
        return any(drive.state in _DRIVING for drive in self._drives)

    def guard(self, may_enable, on_enabled):
        """Enable an axis only while `may_enable()`, and call `on_enabled()` when one is enabled."""
        for drive in self._drives:
            drive.may_enable = may_enable
            drive.on_enabled = on_enabled

    def switch_off(self):
        """Switch the motors off; those that brake for a fault go on until they stand."""
        self._control(cia402.DISABLE_VOLTAGE)

    def cut(self):
        """Switch all motors off at once."""
        for drive in self._drives:
            drive.cut()

    def reset(self):
        """Switch the motors off, and drop faults and targets."""
        for drive in self._drives:
            drive.reset()

    def fail(self, error_code):
        """Switch the motors off by a fault that comes from outside the speed loop."""
        for drive in self._drives:
            drive.fail(error_code)

    def fall_silent(self, error_code):
        """Brake, as far as settings say so, and go to 'fault': who commands is gone."""
        for drive in self._drives:
            drive.fall_silent(error_code)

    def _control(self, controlword):
        for drive in self._drives:
            drive.control(controlword)


def _halt(drive):
    """The halt bit as the host has set it: it stays its own."""
    return drive.controlword & cia402.CONTROL_HALT
