"""The drive's state machine, by the transitions of CiA 402-2."""

from array import array

from mdms_cell.drive import axes as d
from mdms_cell.drive import speed_loop as s
from mdms_cell.drive import tuning
from mdms_protocol.codecs import cia402 as c

COMMANDS = (
    c.SHUTDOWN,
    c.SWITCH_ON,
    c.ENABLE_OPERATION,
    c.DISABLE_VOLTAGE,
    c.QUICK_STOP,
    c.FAULT_RESET,
)

# The next state by controlword and state, written out from figure 'state machine' of CiA 402-2:
# columns as COMMANDS, 0 for no transition.
EXPECTED = {
    c.SWITCH_ON_DISABLED: (c.READY_TO_SWITCH_ON, 0, 0, 0, 0, 0),
    c.READY_TO_SWITCH_ON: (
        0,
        c.SWITCHED_ON,
        c.OPERATION_ENABLED,
        c.SWITCH_ON_DISABLED,
        c.SWITCH_ON_DISABLED,
        0,
    ),
    c.SWITCHED_ON: (
        c.READY_TO_SWITCH_ON,
        0,
        c.OPERATION_ENABLED,
        c.SWITCH_ON_DISABLED,
        c.SWITCH_ON_DISABLED,
        0,
    ),
    c.OPERATION_ENABLED: (
        c.READY_TO_SWITCH_ON,
        c.SWITCHED_ON,
        0,
        c.SWITCH_ON_DISABLED,
        c.QUICK_STOP_ACTIVE,
        0,
    ),
    c.QUICK_STOP_ACTIVE: (0, 0, 0, c.SWITCH_ON_DISABLED, 0, 0),
    c.FAULT_REACTION: (0, 0, 0, 0, 0, 0),
    c.FAULT: (0, 0, 0, 0, 0, c.SWITCH_ON_DISABLED),
}

# The controlwords that lead to each state from the start; a failure leads to 'fault'.
WAYS = {
    c.SWITCH_ON_DISABLED: (),
    c.READY_TO_SWITCH_ON: (c.SHUTDOWN,),
    c.SWITCHED_ON: (c.SHUTDOWN, c.SWITCH_ON),
    c.OPERATION_ENABLED: (c.SHUTDOWN, c.SWITCH_ON, c.ENABLE_OPERATION),
    c.QUICK_STOP_ACTIVE: (c.SHUTDOWN, c.SWITCH_ON, c.ENABLE_OPERATION, c.QUICK_STOP),
}


HEARTBEAT_LOST = 0x8130


class Axis:
    """A drive over its registers, with a wheel that stands still."""

    def __init__(self):
        self.registers = array("i", [0] * s.REGISTERS)
        s.reset(self.registers)
        self.registers[s.AGE_LIMIT] = 50
        self.registers[s.BRAKE_TICKS] = 1000
        for base in (0, s.AXIS):
            tuning.set_encoder(self.registers, base, 37_596)
            tuning.set_law(self.registers, base, 10_000, 24_000)
            tuning.set_brake(self.registers, base, 10_000, 24_000)
            self.registers[base + s.WINDOW] = 5_000
            self.registers[base + s.WINDOW_TICKS] = 10
        self.drive = d.Drive(self.registers, 0)

    def tick(self, count=1):
        code = 0
        for _ in range(count):
            s.step(self.registers)
            code = self.drive.poll() or code
        return code

    def voltage_uv(self):
        return self.registers[s.VOLTAGE]


def braking_axis(target_um_s=0):
    """Enabled, and to brake at 1 m/s2 when it is commanded no more."""
    axis = axis_in(c.OPERATION_ENABLED)
    tuning.set_ramps(axis.registers, 0, 0, 0, 1_000_000)
    axis.registers[s.REACTION] = 1
    axis.drive.set_target(target_um_s)
    return axis


def axis_in(state):
    axis = Axis()
    if state == c.FAULT:
        axis.drive.fail(d.STALLED)
    elif state == c.FAULT_REACTION:
        axis = braking_axis(100_000)
        axis.drive.fall_silent(HEARTBEAT_LOST)
    else:
        for controlword in WAYS[state]:
            axis.drive.control(controlword)
    assert axis.drive.state == state
    return axis


def test_every_controlword_in_every_state_follows_the_standard():
    for state, row in EXPECTED.items():
        for column, expected in enumerate(row):
            axis = axis_in(state)
            axis.drive.control(COMMANDS[column])
            assert axis.drive.state == (expected or state), (state, COMMANDS[column])


def test_voltage_is_zero_in_every_state_but_operation_enabled():
    for state in EXPECTED:
        axis = axis_in(state)
        axis.drive.set_target(100_000)
        axis.tick()
        on = state == c.OPERATION_ENABLED
        assert (axis.voltage_uv() != 0) == on, state


def test_statusword_tells_the_state():
    for state in EXPECTED:
        assert c.state(axis_in(state).drive.statusword()) == state


def test_a_failure_in_any_state_leads_to_fault_and_keeps_its_first_cause():
    for state in EXPECTED:
        axis = axis_in(state)
        axis.drive.fail(d.OVER_CURRENT)
        assert axis.drive.state == c.FAULT
        assert axis.drive.error_code == (d.STALLED if state == c.FAULT else d.OVER_CURRENT)


def test_fault_reset_works_on_the_rising_edge_only():
    axis = Axis()
    axis.drive.control(c.FAULT_RESET)
    axis.drive.fail(d.STALLED)
    axis.drive.control(c.FAULT_RESET)
    assert axis.drive.state == c.FAULT
    axis.drive.control(0)
    axis.drive.control(c.FAULT_RESET)
    assert axis.drive.state == c.SWITCH_ON_DISABLED
    assert axis.drive.error_code == 0


def test_target_older_than_the_switching_on_is_not_stale():
    axis = axis_in(c.SWITCHED_ON)
    axis.tick(1000)
    axis.drive.control(c.ENABLE_OPERATION)
    assert axis.tick(50) == 0


def test_stale_target_has_the_wheel_braked_and_held_before_the_fault():
    axis = braking_axis(100_000)
    assert axis.tick(50) == 0
    assert axis.tick() == d.STALE_SETPOINT
    assert axis.drive.state == c.FAULT_REACTION
    assert axis.registers[s.DEMAND] == 99_000
    axis.drive.set_target(100_000)
    axis.tick(50)
    assert axis.registers[s.DEMAND] == 49_000
    axis.tick(49 + s.STILL_TICKS - 5)
    assert axis.drive.state == c.FAULT_REACTION
    axis.tick(10)
    assert axis.drive.state == c.FAULT
    assert axis.drive.error_code == d.STALE_SETPOINT
    assert axis.voltage_uv() == 0


def test_stale_target_is_braked_by_the_tick_alone():
    axis = braking_axis(100_000)
    for tick in range(60 + 100 + s.STILL_TICKS):
        s.step(axis.registers)
        assert tick < 60 or axis.registers[s.DEMAND] < 95_000
    assert axis.registers[s.FAULTS] == s.STALE
    axis.registers[s.COUNT] += 400  # dragged on
    s.step(axis.registers)
    assert axis.voltage_uv() == 0


def test_braking_of_a_wheel_that_is_pushed_ends_with_its_time():
    for polled in (True, False):
        axis = braking_axis(100_000)
        for tick in range(50 + 1002):
            axis.registers[s.COUNT] += 4  # 0.1 m/s, for ever
            s.step(axis.registers)
            if polled:
                axis.drive.poll()
            assert tick > 1048 or axis.voltage_uv() != 0
        assert axis.voltage_uv() == 0
        assert axis.drive.state == (c.FAULT if polled else c.OPERATION_ENABLED)


def test_another_fault_ends_the_braking_at_once():
    axis = braking_axis(100_000)
    axis.tick(60)
    tuning.set_over_current(axis.registers, 0, 3_000, 1)
    axis.registers[s.CURRENT] = 4_000
    assert axis.tick() == d.OVER_CURRENT
    assert axis.voltage_uv() == 0
    assert axis.drive.state == c.FAULT
    for cut in ("fail", "cut", "register"):
        axis = braking_axis(100_000)
        axis.tick(60)
        assert axis.voltage_uv() != 0
        if cut == "fail":
            axis.drive.fail(d.STALLED)
        elif cut == "cut":
            axis.drive.cut()
        else:
            axis.registers[s.CUT] = 1
        axis.tick()
        assert axis.voltage_uv() == 0, cut


def test_second_silence_does_not_shorten_the_braking():
    axis = braking_axis(100_000)
    axis.tick(60)
    axis.drive.fall_silent(HEARTBEAT_LOST)
    assert axis.drive.state == c.FAULT_REACTION
    assert axis.drive.error_code == d.STALE_SETPOINT


def test_axis_that_is_off_has_nothing_to_brake():
    for state in (c.SWITCH_ON_DISABLED, c.SWITCHED_ON):
        axis = axis_in(state)
        axis.registers[s.REACTION] = 1
        axis.drive.fall_silent(HEARTBEAT_LOST)
        assert axis.drive.state == c.FAULT
        assert axis.drive.error_code == HEARTBEAT_LOST


def test_every_way_out_of_operation_enabled_drops_the_target():
    for controlword in (c.SHUTDOWN, c.SWITCH_ON, c.DISABLE_VOLTAGE, c.QUICK_STOP):
        axis = axis_in(c.OPERATION_ENABLED)
        axis.drive.set_target(100_000)
        axis.drive.control(controlword)
        assert axis.drive.target_um_s == 0
        axis.tick(100)
        stands_when_enabled(axis)
    axis = axis_in(c.OPERATION_ENABLED)
    axis.drive.set_target(100_000)
    axis.drive.fail(d.STALLED)
    assert axis.drive.target_um_s == 0
    axis.drive.control(0)
    axis.drive.control(c.FAULT_RESET)
    stands_when_enabled(axis)


def test_target_that_came_before_enabling_moves_nothing():
    axis = axis_in(c.SWITCHED_ON)
    axis.drive.set_target(100_000)
    stands_when_enabled(axis)


def stands_when_enabled(axis):
    """Enabled, the wheel stands until a target comes."""
    for controlword in WAYS[c.OPERATION_ENABLED]:
        axis.drive.control(controlword)
    assert axis.drive.state == c.OPERATION_ENABLED
    for _ in range(40):
        axis.tick()
        assert axis.voltage_uv() == 0
    axis.drive.set_target(50_000)
    axis.tick()
    assert axis.voltage_uv() == 500_000


def test_halt_takes_the_target_away_and_gives_it_back():
    axis = axis_in(c.OPERATION_ENABLED)
    axis.drive.set_target(100_000)
    axis.drive.control(c.ENABLE_OPERATION | c.CONTROL_HALT)
    axis.tick()
    assert axis.voltage_uv() == 0
    axis.drive.set_target(200_000)
    axis.tick()
    assert axis.voltage_uv() == 0
    axis.drive.control(c.ENABLE_OPERATION)
    axis.tick()
    assert axis.voltage_uv() == 2_000_000


def test_target_beyond_every_limit_is_clipped():
    axis = axis_in(c.OPERATION_ENABLED)
    axis.drive.set_target((1 << 31) - 1)
    assert axis.drive.target_um_s == s.SPEED_MAX_UM_S
    axis.drive.set_target(-(1 << 31))
    assert axis.drive.target_um_s == -s.SPEED_MAX_UM_S


def test_target_reached_and_standstill_are_told_after_the_window_time():
    axis = axis_in(c.OPERATION_ENABLED)
    axis.drive.set_target(4_000)
    axis.tick(10)
    assert not axis.drive.statusword() & c.TARGET_REACHED
    axis.tick()
    assert axis.drive.statusword() & c.TARGET_REACHED
    assert axis.drive.statusword() & c.SPEED_ZERO
    axis.drive.set_target(100_000)
    axis.tick()
    assert not axis.drive.statusword() & c.TARGET_REACHED


def test_faults_of_the_speed_loop_are_told_by_their_codes():
    for bit, code in (
        (s.STALE, 0x8250),
        (s.OVER_CURRENT, 0x2310),
        (s.STALLED, 0x7121),
        (s.UNDERVOLTAGE, 0x3220),
        (s.REVERSED, 0x7302),
        (s.FOLLOWING, 0x8611),
    ):
        axis = axis_in(c.OPERATION_ENABLED)
        axis.registers[s.FAULTS] = bit
        assert axis.tick() == code
        assert axis.drive.error_code == code
        assert axis.drive.state == c.FAULT


# From the first of them the neighbour layer leads on by itself.
ABOVE_READY = (
    c.SWITCHED_ON,
    c.OPERATION_ENABLED,
    c.QUICK_STOP_ACTIVE,
    c.FAULT_REACTION,
)


def test_low_supply_is_a_fault_in_every_state_above_ready_to_switch_on():
    for state in ABOVE_READY:
        axis = axis_in(state)
        # A wheel that turns is stopped for long.
        axis.registers[s.ACTUAL] = axis.registers[s.DEMAND] = 400_000
        axis.registers[s.RATE] = 40 << 14
        axis.registers[s.QUICK_STOP] = 1
        axis.registers[s.SUPPLY_MIN] = 10_000_000
        axis.registers[s.SUPPLY] = 9_999_999
        codes = [axis.tick() for _ in range(s.LOW_TICKS)]
        assert codes == [0] * (s.LOW_TICKS - 1) + [d.UNDERVOLTAGE], state
        assert axis.drive.state == c.FAULT
        axis.registers[s.SUPPLY] = 24_000_000
        for word in (c.SHUTDOWN, c.SWITCH_ON, c.ENABLE_OPERATION):
            axis.drive.control(word)
            axis.drive.set_target(100_000)
            axis.tick(10)
            assert axis.voltage_uv() == 0
        assert axis.drive.state == c.FAULT


def test_low_supply_that_is_over_before_the_background_looks_is_a_fault_all_the_same():
    for state in ABOVE_READY:
        axis = axis_in(state)
        axis.registers[s.SUPPLY_MIN] = 10_000_000
        axis.registers[s.SUPPLY] = 0
        for _ in range(s.LOW_TICKS):
            s.step(axis.registers)
        axis.registers[s.SUPPLY] = 24_000_000
        s.step(axis.registers)
        # As the layer does, before the drive has been polled.
        axis.drive.control(c.ENABLE_OPERATION)
        axis.drive.set_target(100_000)
        s.step(axis.registers)
        assert axis.voltage_uv() == 0
        assert axis.drive.poll() == d.UNDERVOLTAGE
        assert axis.drive.state == c.FAULT


def test_low_supply_in_the_fault_of_a_silence_is_a_fault_of_the_supply_until_it_is_reset():
    # An emergency stop that is pressed after the host has gone, and released before it is back.
    for code in (0x8130, 0x8140, 0x8250):
        axis = Axis()
        axis.drive.fail(code)
        axis.registers[s.SUPPLY_MIN] = 10_000_000
        assert [axis.tick() for _ in range(s.LOW_TICKS)] == [0] * 4 + [d.UNDERVOLTAGE]
        assert axis.tick(10) == 0
        axis.registers[s.SUPPLY] = 24_000_000
        axis.tick(10)
        assert (axis.drive.state, axis.drive.error_code) == (c.FAULT, d.UNDERVOLTAGE)
        axis.drive.control(c.FAULT_RESET)
        axis.tick(10)
        assert (axis.drive.state, axis.drive.error_code) == (c.SWITCH_ON_DISABLED, 0)


def test_low_supply_hides_no_fault_of_the_wheel():
    axis = axis_in(c.FAULT)
    axis.registers[s.SUPPLY_MIN] = 10_000_000
    assert axis.tick(10) == 0
    assert axis.drive.error_code == d.STALLED
