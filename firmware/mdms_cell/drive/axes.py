"""The axes of a cell on the bus: objects of CiA 402 and settings, tied to drives and speed loop.

Indices are those of axis 1; axis 2 has them `indices.AXIS_OFFSET` higher.
"""

from mdms_cell.drive import speed_loop, tuning
from mdms_cell.drive.state_machine import DRIVING, UNDERVOLTAGE, Drive
from mdms_protocol import indices
from mdms_protocol.codecs import cia402, sdo
from mdms_protocol.compat import micropython

_VELOCITY_REVERSED = 0x40

# Fault reaction option code (CiA 402-2): 0 V at once, or the quick stop's ramp
_DISABLE = 0
_QUICK_STOP_RAMP = 2

#: Where a trial voltage limit is taken: the motor is off, and about to be enabled.
_ON_THE_WAY = (cia402.READY_TO_SWITCH_ON, cia402.SWITCHED_ON)

_SETTINGS = (
    indices.GAIN,
    indices.RESOLUTION,
    indices.VOLTAGE_LIMIT,
    indices.STALL_VOLTAGE,
    indices.STALL_TIME,
    indices.REVERSAL_VOLTAGE,
    indices.REVERSAL_TIME,
    indices.OVER_CURRENT_TIME,
    indices.SLIPPAGE_TIME,
    indices.OBSERVER_LAG,
    indices.ACCELERATION_PER_VOLT,
    indices.WINDOW,
    indices.WINDOW_TIME,
    indices.MAX_CURRENT,
    indices.RATED_CURRENT,
    indices.POLARITY,
    indices.ACCELERATION,
    indices.DECELERATION,
    indices.QUICK_STOP,
    indices.FAULT_REACTION,
    indices.BRAKING_GAIN,
    indices.MAX_SLIPPAGE,
)
#: Settings of how a count of the encoder is read. They stay as they are while a wheel is on.
_READING = (indices.RESOLUTION, indices.POLARITY)
_ON = DRIVING + (cia402.SWITCHED_ON,)  # noqa: RUF005 - MicroPython takes no star in a tuple
_FAILED = (cia402.FAULT, cia402.FAULT_REACTION)


class Axis:
    """Axis `number`, counted from 0.

    A trial voltage limit (0x2010) lowers the stored limit until the axis is off again or in fault.
    So it ends even if the host that set it is gone, and binds no later enabling.
    """

    def __init__(self, number, objects, registers):
        self._objects = objects
        self._registers = registers
        self._base = number * speed_loop.AXIS
        self._offset = number * indices.AXIS_OFFSET
        self._trial_limit_mv = 0
        self.drive = Drive(registers, self._base, self._end_trial)
        self._tie_commands()
        self._tie_readings()
        objects.watch(self._on_setting, *[index + self._offset for index in _SETTINGS])
        self.load()

    def load(self):
        """Bring the stored settings into the speed loop."""
        registers = self._registers
        base = self._base
        setting = self._setting
        resolution = setting(indices.RESOLUTION)
        reversed_ = setting(indices.POLARITY) & _VELOCITY_REVERSED
        tuning.set_direction(registers, base, 1 if reversed_ else 0)
        tuning.set_encoder(registers, base, resolution, setting(indices.OBSERVER_LAG))
        tuning.set_feed(registers, base, resolution, setting(indices.ACCELERATION_PER_VOLT))
        self._load_law(registers, base, setting)
        acceleration, deceleration = setting(indices.ACCELERATION), setting(indices.DECELERATION)
        quick_stop = setting(indices.QUICK_STOP)
        tuning.set_ramps(registers, base, acceleration, deceleration, quick_stop)
        ramped = setting(indices.FAULT_REACTION) == _QUICK_STOP_RAMP
        registers[base + speed_loop.REACTION] = 1 if ramped else 0
        registers[base + speed_loop.WINDOW] = setting(indices.WINDOW)
        registers[base + speed_loop.WINDOW_TICKS] = setting(indices.WINDOW_TIME)
        self._load_watching(registers, base, setting, resolution)

    def _load_law(self, registers, base, setting):
        """Set gains and the voltage limit, the trial's while there is one and it is lower."""
        limit_mv = setting(indices.VOLTAGE_LIMIT)
        if self._trial_limit_mv:
            limit_mv = min(limit_mv, self._trial_limit_mv)
        tuning.set_law(registers, base, setting(indices.GAIN), limit_mv)
        tuning.set_brake(registers, base, setting(indices.BRAKING_GAIN), limit_mv)

    def _load_watching(self, registers, base, setting, resolution):
        """Set the watched limits and their times."""
        limit_ma = setting(indices.MAX_CURRENT) * setting(indices.RATED_CURRENT) // 1000
        tuning.set_over_current(registers, base, limit_ma, setting(indices.OVER_CURRENT_TIME))
        voltage_mv, time_ms = setting(indices.STALL_VOLTAGE), setting(indices.STALL_TIME)
        tuning.set_stall(registers, base, resolution, voltage_mv, time_ms)
        voltage_mv, time_ms = setting(indices.REVERSAL_VOLTAGE), setting(indices.REVERSAL_TIME)
        tuning.set_reversal(registers, base, voltage_mv, time_ms)
        limit_um_s, time_ms = setting(indices.MAX_SLIPPAGE), setting(indices.SLIPPAGE_TIME)
        tuning.set_following(registers, base, limit_um_s, time_ms)

    def _on_setting(self, index, _sub):
        if index - self._offset in _READING and self.drive.state in _ON:
            raise sdo.AbortError(sdo.WRONG_STATE)
        if self._setting(indices.FAULT_REACTION) not in (_DISABLE, _QUICK_STOP_RAMP):
            raise sdo.AbortError(sdo.INVALID_VALUE)
        self.load()

    def _setting(self, index):
        return self._objects.number(index + self._offset)

    # Methods rather than lambdas, which would take three times the memory, for each axis.

    def _tie_commands(self):
        drive = self.drive
        self._tie(indices.CONTROLWORD, self._controlword, drive.control)
        self._tie(indices.TARGET, self._target_um_s, drive.take_target)
        self._tie(indices.TRIAL_VOLTAGE_LIMIT, self._trial_limit, self._begin_trial)
        self._tie(indices.STATUSWORD, drive.statusword)
        self._tie(indices.ERROR_CODE, self._error_code)

    def _tie_readings(self):
        self._tie(indices.ACTUAL, self._actual_reader())
        self._tie(indices.DEMAND, self._demand_um_s)
        self._tie(indices.POSITION, self._position)
        self._tie(indices.MOTOR_VOLTAGE, self._voltage_uv)
        self._tie(indices.SUPPLY, self._supply_mv)
        self._tie(indices.CURRENT, self._current_per_mille)

    def _tie(self, index, read, write=None):
        self._objects.tie(index + self._offset, 0, read, write)

    def _actual_reader(self):
        """A function that returns the speed, called at every SYNC; it looks up nothing."""
        registers = self._registers
        actual = self._base + speed_loop.ACTUAL
        return lambda: registers[actual]

    def _trial_limit(self):
        return self._trial_limit_mv

    def _begin_trial(self, limit_mv):
        """Take a limit for the next enabling; raises AbortError unless the axis is about to be."""
        if self.drive.state not in _ON_THE_WAY:
            raise sdo.AbortError(sdo.WRONG_STATE)
        self._trial_limit_mv = limit_mv
        self._load_law(self._registers, self._base, self._setting)

    def _end_trial(self):
        if self._trial_limit_mv:
            self._trial_limit_mv = 0
            self._load_law(self._registers, self._base, self._setting)

    def _controlword(self):
        return self.drive.controlword

    def _target_um_s(self):
        return self.drive.target_um_s

    def _error_code(self):
        return self.drive.error_code

    def _demand_um_s(self):
        return self._registers[self._base + speed_loop.DEMAND]

    def _position(self):
        """Counts since the start as a signed number of 32 bits, as wired."""
        turns = self._registers[self._base + speed_loop.TURNS]
        count = self._registers[self._base + speed_loop.LAST_COUNT]
        if turns != self._registers[self._base + speed_loop.TURNS]:
            # A tick came in between; the next is a millisecond away.
            turns = self._registers[self._base + speed_loop.TURNS]
            count = self._registers[self._base + speed_loop.LAST_COUNT]
        return ((turns ^ 0x8000) - 0x8000 << 16) | count

    def _voltage_uv(self):
        return self._registers[self._base + speed_loop.VOLTAGE]

    def _supply_mv(self):
        return self._registers[speed_loop.SUPPLY] // 1000

    def _current_per_mille(self):
        current_ma = self._registers[self._base + speed_loop.CURRENT]
        per_mille = current_ma * 1000 // self._setting(indices.RATED_CURRENT)
        return min(max(per_mille, -32768), 32767)


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
            if drive.state == cia402.SWITCHED_ON:
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
        """Follow the events of the speed loop.

        Too low a supply is reported in every state. From 'switched on' on it is a fault.
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

    def lose_supply(self):
        """Take the supply of axes that are on for too low, at any measured voltage."""
        for source, drive in enumerate(self._drives, 1):
            if drive.state in _ON:
                drive.fail(UNDERVOLTAGE)
                self._emcy.report(source, UNDERVOLTAGE)

    def driving(self):
        """Whether any motor is on."""
        return any(drive.state in DRIVING for drive in self._drives)

    def follow(self):
        """Whether any wheel follows its target."""
        return any(drive.follows() for drive in self._drives)

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
