"""The axes of a cell: the state machine of CiA 402-2 around the speed loop, and its objects.

The motor is driven in 'operation enabled'. It is driven in 'quick stop active' and 'fault reaction
active' too, until it stands or their time is over. In every other state the speed loop brakes at 0
V, then the bridges sleep. The speed loop cuts the voltage, or begins to brake, in the tick in which
it finds a fault. `poll` takes the next state afterwards. A change of the state sets ATTENTION for
the background, as the speed loop does.

The neighbour layer enables an axis that is 'switched on' without another controlword. So too low a
supply, which is an emergency stop, is a fault there as well. Only a controlword of another node
leads on from the states below. A host that is back resets the fault of its own silence by itself.
So too low a supply meanwhile takes the place of such a fault, and a stop does.

A target is valid in the 'operation enabled' in which it came. Every way into and out of that state
sets it to 0.

Indices are those of axis 1; axis 2 has them `indices.AXIS_OFFSET` higher.
"""

from mdms_cell.drive import speed_loop, tuning
from mdms_protocol import indices
from mdms_protocol.codecs import cia402, sdo
from mdms_protocol.compat import micropython

# The drive of one axis ----------------------------------------------------------------------------

# Events besides the controlword's commands, which stand for themselves
FAILURE = 0x100
STANDSTILL = 0x101
SILENCE = 0x102

#: All transitions with their numbers in CiA 402-2, by state and event in one number, which takes
#: less memory than a pair. Any other event changes nothing.
#: The reaction to a failure, voltage off, is complete at once, so 13 and 14 are one. The wheel is
#: braked in between only if it can still be trusted and its commands have ended.
TRANSITIONS = {
    cia402.SWITCH_ON_DISABLED | cia402.SHUTDOWN << 8: cia402.READY_TO_SWITCH_ON,  # 2
    cia402.READY_TO_SWITCH_ON | cia402.SWITCH_ON << 8: cia402.SWITCHED_ON,  # 3
    cia402.READY_TO_SWITCH_ON | cia402.ENABLE_OPERATION << 8: cia402.OPERATION_ENABLED,  # 3, 4
    cia402.SWITCHED_ON | cia402.ENABLE_OPERATION << 8: cia402.OPERATION_ENABLED,  # 4
    cia402.OPERATION_ENABLED | cia402.SWITCH_ON << 8: cia402.SWITCHED_ON,  # 5
    cia402.SWITCHED_ON | cia402.SHUTDOWN << 8: cia402.READY_TO_SWITCH_ON,  # 6
    cia402.READY_TO_SWITCH_ON | cia402.QUICK_STOP << 8: cia402.SWITCH_ON_DISABLED,  # 7
    cia402.READY_TO_SWITCH_ON | cia402.DISABLE_VOLTAGE << 8: cia402.SWITCH_ON_DISABLED,  # 7
    cia402.OPERATION_ENABLED | cia402.SHUTDOWN << 8: cia402.READY_TO_SWITCH_ON,  # 8
    cia402.OPERATION_ENABLED | cia402.DISABLE_VOLTAGE << 8: cia402.SWITCH_ON_DISABLED,  # 9
    cia402.SWITCHED_ON | cia402.QUICK_STOP << 8: cia402.SWITCH_ON_DISABLED,  # 10
    cia402.SWITCHED_ON | cia402.DISABLE_VOLTAGE << 8: cia402.SWITCH_ON_DISABLED,  # 10
    cia402.OPERATION_ENABLED | cia402.QUICK_STOP << 8: cia402.QUICK_STOP_ACTIVE,  # 11
    cia402.QUICK_STOP_ACTIVE | cia402.DISABLE_VOLTAGE << 8: cia402.SWITCH_ON_DISABLED,  # 12
    cia402.QUICK_STOP_ACTIVE | STANDSTILL << 8: cia402.SWITCH_ON_DISABLED,  # 12
    cia402.SWITCH_ON_DISABLED | FAILURE << 8: cia402.FAULT,  # 13, 14
    cia402.READY_TO_SWITCH_ON | FAILURE << 8: cia402.FAULT,  # 13, 14
    cia402.SWITCHED_ON | FAILURE << 8: cia402.FAULT,  # 13, 14
    cia402.OPERATION_ENABLED | FAILURE << 8: cia402.FAULT,  # 13, 14
    cia402.QUICK_STOP_ACTIVE | FAILURE << 8: cia402.FAULT,  # 13, 14
    cia402.OPERATION_ENABLED | SILENCE << 8: cia402.FAULT_REACTION,  # 13
    cia402.QUICK_STOP_ACTIVE | SILENCE << 8: cia402.FAULT_REACTION,  # 13
    cia402.FAULT_REACTION | STANDSTILL << 8: cia402.FAULT,  # 14
    cia402.FAULT_REACTION | FAILURE << 8: cia402.FAULT,  # 14
    cia402.FAULT | cia402.FAULT_RESET << 8: cia402.SWITCH_ON_DISABLED,  # 15
}

MODES = {
    cia402.SWITCHED_ON: speed_loop.SWITCHED_ON,
    cia402.OPERATION_ENABLED: speed_loop.RUN,
    cia402.QUICK_STOP_ACTIVE: speed_loop.STOP,
    cia402.FAULT_REACTION: speed_loop.BRAKE,
}
_RAMPED = (speed_loop.STOP, speed_loop.BRAKE)
_FAILED = (cia402.FAULT, cia402.FAULT_REACTION)
_OFF = (cia402.SWITCH_ON_DISABLED, cia402.FAULT)
#: The motor is on.
DRIVING = (cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE, cia402.FAULT_REACTION)

# Error codes of CiA 301 and CiA 402-2, as in 0x603F and in the emergency message
STALE_SETPOINT = 0x8250
OVER_CURRENT = 0x2310
UNDERVOLTAGE = 0x3220
STALLED = 0x7121
REVERSED = 0x7302
FOLLOWING_ERROR = 0x8611
STOPPED_MEANWHILE = 0x9000
#: Their upper bytes where communication has failed, and not the axis.
_COMMUNICATION = (0x81, 0x82)

_ERROR_CODES = (
    (speed_loop.OVER_CURRENT, OVER_CURRENT),
    (speed_loop.UNDERVOLTAGE, UNDERVOLTAGE),
    (speed_loop.REVERSED, REVERSED),
    (speed_loop.STALLED, STALLED),
    (speed_loop.FOLLOWING, FOLLOWING_ERROR),
)


def command_of(controlword):
    """The command that a controlword gives by its bits 0 to 3 (CiA 402-2, table 27)."""
    if not controlword & cia402.CONTROL_VOLTAGE:
        return cia402.DISABLE_VOLTAGE
    if not controlword & cia402.CONTROL_NO_QUICK_STOP:
        return cia402.QUICK_STOP
    if not controlword & cia402.CONTROL_SWITCH_ON:
        return cia402.SHUTDOWN
    if controlword & cia402.CONTROL_ENABLE:
        return cia402.ENABLE_OPERATION
    return cia402.SWITCH_ON


class Drive:
    """The drive of the axis with registers from `base` on; it starts switched off.

    If `may_enable()` is given and false, 'enable operation' leads to 'switched on' only.
    `on_enabled()`, if given, is called on the way into 'operation enabled'. `on_off()`, if given,
    is called once the voltage is 0, whenever the motor goes off. Every way into 'switch on
    disabled' and 'fault' counts, though the motor was off before.
    """

    def __init__(self, registers, base, on_off=None):
        self.registers = registers
        self.base = base
        self.state = cia402.SWITCH_ON_DISABLED
        self.controlword = 0
        self.error_code = 0
        self.target_um_s = 0
        self.may_enable = None
        self.on_enabled = None
        self.on_off = on_off
        self.led = False
        self._enter(cia402.SWITCH_ON_DISABLED)

    def control(self, controlword):
        """Take a controlword: one command, or the rising edge of fault reset."""
        reset = controlword & ~self.controlword & cia402.CONTROL_FAULT_RESET
        self.controlword = controlword
        if reset:
            self._happen(cia402.FAULT_RESET)
        elif not controlword & cia402.CONTROL_FAULT_RESET:
            self._happen(self._allowed(command_of(controlword)))
        self._aim()

    def take_target(self, target_um_s):
        """`set_target` from the bus: nothing happens while the neighbour layer leads the wheel."""
        if not self.led:
            self.set_target(target_um_s)

    @micropython.native
    def set_target(self, target_um_s):
        """Take a target velocity [um/s] as fresh, clipped to the range of the speed loop.

        It moves the wheel in 'operation enabled' only. The next 'operation enabled' begins with 0.
        """
        if target_um_s > speed_loop.SPEED_MAX_UM_S:
            target_um_s = speed_loop.SPEED_MAX_UM_S
        elif target_um_s < -speed_loop.SPEED_MAX_UM_S:
            target_um_s = -speed_loop.SPEED_MAX_UM_S
        self.target_um_s = target_um_s
        self._aim()
        self.registers[self.base + speed_loop.AGE] = 0

    def reset(self):
        """Switch off, and drop the fault, the controlword and the target."""
        self.cut()
        self.control(cia402.FAULT_RESET)
        self.control(cia402.DISABLE_VOLTAGE)
        self.target_um_s = 0
        self._aim()

    def cut(self):
        """Switch off at once, from 'fault reaction active' too, which no controlword ends."""
        if self.state == cia402.FAULT_REACTION:
            self._happen(FAILURE)
        self.control(cia402.DISABLE_VOLTAGE)

    def fail(self, error_code):
        """Cut the motor and go to 'fault', for a reason from outside the speed loop."""
        self.registers[self.base + speed_loop.MODE] = speed_loop.OFF
        if self._happen(FAILURE):
            self.error_code = error_code

    def fall_silent(self, error_code):
        """Go to 'fault' after the commands have ended; a motor that is on may brake first."""
        if self.state == cia402.FAULT_REACTION:
            return
        if self.registers[self.base + speed_loop.REACTION] and self._happen(SILENCE):
            self.error_code = error_code
        else:
            self.fail(error_code)

    @micropython.native
    def poll(self):
        """Follow the events of the speed loop; return the error code of a new fault, or 0."""
        registers = self.registers
        base = self.base
        faults = registers[base + speed_loop.FAULTS]
        if faults == speed_loop.STALE and self.state not in _FAILED:
            self.fall_silent(STALE_SETPOINT)
            return STALE_SETPOINT
        if faults & ~speed_loop.STALE and self.state != cia402.FAULT:
            for bit, code in _ERROR_CODES:
                if faults & bit:
                    self.fail(code)
                    return code
        if registers[base + speed_loop.SIGNS] & speed_loop.STOPPED:
            self._happen(STANDSTILL)
        if self.error_code >> 8 in _COMMUNICATION and self.lacks_supply():
            self.error_code = UNDERVOLTAGE
            return UNDERVOLTAGE
        return 0

    def lacks_supply(self):
        """Whether the motor's supply has been too low for `speed_loop.LOW_TICKS`."""
        return self.registers[self.base + speed_loop.SIGNS] & speed_loop.LOW_SUPPLY

    @micropython.native
    def statusword(self):
        """The statusword of CiA 402-2 with the bits of profile velocity."""
        registers = self.registers
        base = self.base
        signs = registers[base + speed_loop.SIGNS]
        word = self.state | cia402.REMOTE
        if not signs & speed_loop.LOW_SUPPLY:
            word |= cia402.VOLTAGE_ENABLED
        if signs & speed_loop.AT_TARGET:
            word |= cia402.TARGET_REACHED
        if signs & speed_loop.STANDING:
            word |= cia402.SPEED_ZERO
        if registers[base + speed_loop.FAULTS] & speed_loop.FOLLOWING:
            word |= cia402.SLIPPAGE
        return word

    def _allowed(self, command):
        allowed = self.may_enable is None or self.may_enable()
        if command == cia402.ENABLE_OPERATION and not allowed:
            return cia402.SWITCH_ON
        return command

    def _happen(self, event):
        state = TRANSITIONS.get(self.state | event << 8)
        if state is None:
            return False
        self._enter(state)
        return True

    def _enter(self, state):
        registers = self.registers
        base = self.base
        mode = MODES.get(state, speed_loop.OFF)
        # Not OFF on the way to a ramp: a tick in between would have it begin at 0.
        registers[base + speed_loop.MODE] = mode if mode in _RAMPED else speed_loop.OFF
        goes_off = state in _OFF or (self.state in DRIVING and state not in DRIVING)
        if goes_off and self.on_off is not None:
            self.on_off()
        if self.state == cia402.FAULT:
            registers[base + speed_loop.FAULTS] = 0
            self.error_code = 0
        if cia402.OPERATION_ENABLED in (self.state, state):
            self.target_um_s = 0
        self.state = state
        if state == cia402.OPERATION_ENABLED and self.on_enabled is not None:
            self.on_enabled()
        self._aim()
        registers[base + speed_loop.AGE] = 0
        registers[base + speed_loop.MODE] = mode
        registers[speed_loop.ATTENTION] = 1

    @micropython.native
    def _aim(self):
        target_um_s = self.target_um_s if self.follows() else 0
        self.registers[self.base + speed_loop.TARGET] = target_um_s

    @micropython.native
    def follows(self):
        """Whether the wheel follows its target: enabled, and not halted."""
        halted = self.controlword & cia402.CONTROL_HALT
        return self.state == cia402.OPERATION_ENABLED and not halted


# Objects and settings -----------------------------------------------------------------------------

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

    def be_led(self, led):
        """Whether the neighbour layer sets the targets; those from the bus are not taken then.

        A target of before the change ends with it.
        """
        if led != self._drives[0].led:
            self.rest()
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

    def keep_off(self):
        """Somebody stops the cell: no host that is back resets a fault of its silence by itself."""
        for drive in self._drives:
            if drive.state in _FAILED and drive.error_code >> 8 in _COMMUNICATION:
                drive.error_code = STOPPED_MEANWHILE

    def driving(self):
        """Whether any motor is on."""
        return any(drive.state in DRIVING for drive in self._drives)

    def failed(self):
        """Whether any axis is in 'fault', or brakes on its way there."""
        return any(drive.state in _FAILED for drive in self._drives)

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
