"""The drive's state machine as the bus sees it (CiA 402-2): states, statusword, controlword."""

# States: the bits of the statusword that stand for them.
NOT_READY = 0x00
SWITCH_ON_DISABLED = 0x40
READY_TO_SWITCH_ON = 0x21
SWITCHED_ON = 0x23
OPERATION_ENABLED = 0x27
QUICK_STOP_ACTIVE = 0x07
FAULT_REACTION = 0x0F
FAULT = 0x08

NAMES = {
    NOT_READY: "not ready to switch on",
    SWITCH_ON_DISABLED: "switch on disabled",
    READY_TO_SWITCH_ON: "ready to switch on",
    SWITCHED_ON: "switched on",
    OPERATION_ENABLED: "operation enabled",
    QUICK_STOP_ACTIVE: "quick stop active",
    FAULT_REACTION: "fault reaction active",
    FAULT: "fault",
}

# The rest of the statusword; in profile velocity bit 12 means standstill, bit 13 slippage.
VOLTAGE_ENABLED = 1 << 4
REMOTE = 1 << 9
TARGET_REACHED = 1 << 10
SPEED_ZERO = 1 << 12
SLIPPAGE = 1 << 13

# Bits of the controlword
CONTROL_SWITCH_ON = 1 << 0
CONTROL_VOLTAGE = 1 << 1
CONTROL_NO_QUICK_STOP = 1 << 2
CONTROL_ENABLE = 1 << 3
CONTROL_FAULT_RESET = 1 << 7
CONTROL_HALT = 1 << 8

# Controlwords that command a transition
SHUTDOWN = 0x06
SWITCH_ON = 0x07
ENABLE_OPERATION = 0x0F
DISABLE_VOLTAGE = 0x00
QUICK_STOP = 0x02
FAULT_RESET = 0x80

#: The command of each state that leads one step nearer to 'operation enabled'.
TOWARDS_ENABLED = {
    FAULT: FAULT_RESET,
    SWITCH_ON_DISABLED: SHUTDOWN,
    READY_TO_SWITCH_ON: SWITCH_ON,
    SWITCHED_ON: ENABLE_OPERATION,
    OPERATION_ENABLED: ENABLE_OPERATION,
    QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,
}

_FIVE_BITS = (NOT_READY, SWITCH_ON_DISABLED, FAULT_REACTION, FAULT)


def state(statusword: int) -> int | None:
    """The state that a statusword reports, None if it reports none (CiA 402-2, table 30)."""
    short = statusword & 0x4F
    if short in _FIVE_BITS:
        return short
    long = statusword & 0x6F
    return long if long in NAMES else None
