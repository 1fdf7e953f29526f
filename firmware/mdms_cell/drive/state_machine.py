"""One axis of the drive: the state machine of CiA 402-2 around the registers of the speed loop.

The motor is driven in 'operation enabled'. It is driven in 'quick stop active' and 'fault reaction
active' too, until it stands or their time is over. In every other state the speed loop brakes at 0
V, then the bridges sleep. The speed loop cuts the voltage, or begins to brake, in the tick in which
it finds a fault. `poll` takes the next state afterwards. A change of the state sets ATTENTION for
the background, as the speed loop does.

The neighbour layer enables an axis that is 'switched on' without another controlword. So too low a
supply, which is an emergency stop, is a fault there as well. Only a controlword of another node
leads on from the states below. A host that is back resets the fault of its own silence by itself.
So too low a supply meanwhile takes the place of such a fault.

A target is valid in the 'operation enabled' in which it came. Every way into and out of that state
sets it to 0.
"""

from mdms_cell.drive import speed_loop
from mdms_protocol.codecs import cia402
from mdms_protocol.compat import micropython

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
