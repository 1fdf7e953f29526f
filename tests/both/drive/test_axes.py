"""Both axes together: commands reach both, faults are told by source, settings reach the loop."""

from array import array

from refusal import code_of

from mdms_cell.canopen.objects import Objects, find
from mdms_cell.drive import speed_loop as s
from mdms_cell.drive import tuning
from mdms_cell.drive.axes import Axes
from mdms_protocol.codecs import cia402, sdo

UP = (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)
CONTROLWORDS = (0x6040, 0x6840)
STATUSWORDS = (0x6041, 0x6841)
BASES = (0, s.AXIS)
CODE = 0x8130


class Bench:
    """Both axes over registers, and the errors that they report."""

    def __init__(self):
        self.registers = array("i", [0] * s.REGISTERS)
        s.reset(self.registers)
        self.registers[s.SUPPLY] = 24_000_000
        self.errors = {}
        self.objects = Objects()
        self.axes = Axes(self.objects, self.registers, self)

    def report(self, source, code):
        self.errors[source] = code

    def clear(self, source):
        self.errors.pop(source, None)

    def control(self, axis, *words):
        for word in words:
            self.write(CONTROLWORDS[axis], word)

    def write(self, index, number):
        entry = find(index, 0)
        self.objects.write(entry, number.to_bytes(entry.size, "little"))

    def states(self):
        words = [int.from_bytes(self.objects.read(index, 0), "little") for index in STATUSWORDS]
        return [cia402.state(word) for word in words]

    def modes(self):
        return [self.registers[base + s.MODE] for base in BASES]


def driven():
    bench = Bench()
    for axis in range(2):
        bench.control(axis, *UP)
    assert bench.modes() == [s.RUN, s.RUN]
    return bench


def test_wheel_that_is_enabled_right_after_its_polarity_was_written_stands():
    for count in (1, 3, 20_000, 0x8000, 40_000, 0xFFFF):
        for before, after in ((0, 0x40), (0x40, 0)):
            bench = Bench()
            bench.registers[s.AGE_LIMIT] = 1_000
            bench.write(0x607E, before)
            bench.registers[s.COUNT] = count
            for _ in range(100):
                s.step(bench.registers)
            bench.write(0x607E, after)
            bench.control(0, *UP)
            for _ in range(100):
                s.step(bench.registers)
                assert bench.modes()[0] == s.RUN
                assert abs(bench.registers[s.VOLTAGE]) < 50_000
            assert bench.registers[s.FAULTS] == 0


def test_axes_are_commanded_one_by_one():
    bench = Bench()
    assert not bench.axes.driving()
    bench.control(1, *UP)
    assert bench.modes() == [s.OFF, s.RUN]
    assert bench.axes.driving()
    bench.control(1, cia402.QUICK_STOP)
    assert bench.modes() == [s.OFF, s.STOP]
    assert bench.axes.driving()


def test_switching_off_is_no_fault():
    bench = driven()
    bench.axes.switch_off()
    assert bench.modes() == [s.OFF, s.OFF]
    assert bench.states() == [cia402.SWITCH_ON_DISABLED] * 2
    assert not bench.axes.driving()


def test_failure_from_outside_puts_both_into_fault():
    bench = driven()
    bench.axes.fail(CODE)
    assert bench.modes() == [s.OFF, s.OFF]
    assert bench.states() == [cia402.FAULT] * 2
    for index in (0x603F, 0x683F):
        assert bench.objects.read(index, 0) == b"\x30\x81"


def test_reset_forgets_faults_and_the_next_fault_can_be_reset():
    bench = driven()
    for _ in range(2):
        bench.axes.fail(CODE)
        bench.axes.reset()
        assert bench.states() == [cia402.SWITCH_ON_DISABLED] * 2
    bench.axes.fail(CODE)
    bench.control(0, cia402.FAULT_RESET)
    assert bench.states() == [cia402.SWITCH_ON_DISABLED, cia402.FAULT]


def test_fault_of_the_loop_is_reported_from_its_axis_until_it_is_reset():
    bench = driven()
    bench.registers[s.AXIS + s.FAULTS] = s.STALLED
    bench.axes.poll()
    assert bench.errors == {2: 0x7121}
    assert bench.modes() == [s.RUN, s.OFF]
    bench.axes.poll()
    assert bench.errors == {2: 0x7121}
    bench.control(1, cia402.FAULT_RESET)
    bench.axes.poll()
    assert bench.errors == {}
    assert bench.registers[s.AXIS + s.FAULTS] == 0


def test_every_setting_reaches_the_loop_of_its_axis_alone():
    settings = (
        (0x2000, 5_000, s.GAIN, 80),
        (0x2002, 13_000, s.ERROR_LIMIT, 1_000_000),
        (0x2004, 500, s.STALL_VOLTAGE, 500_000),
        (0x2005, 30, s.STALL_TICKS, 30),
        (0x2006, 70, s.CURRENT_TICKS, 70),
        (0x2007, 90, s.FOLLOWING_TICKS, 90),
        (0x60F8, 50_000, s.FOLLOWING_LIMIT, 50_000),
        (0x6073, 500, s.CURRENT_LIMIT, 1_000),
        (0x6075, 4_000, s.CURRENT_LIMIT, 6_000),
        (0x6083, 2_500, s.ACCELERATION, 3),
        (0x6084, 4_000, s.DECELERATION, 4),
        (0x200F, 50_000, s.BRAKE_GAIN, 800),
        (0x605E, 0, s.REACTION, 0),
        (0x6085, 5_000, s.QUICK_STOP, 5),
        (0x607E, 0x40, s.INVERTED, 1),
    )
    for index, number, register, expected in settings:
        for axis in range(2):
            bench = Bench()
            other = bench.registers[BASES[1 - axis] + register]
            assert other != expected
            bench.write(index + axis * 0x800, number)
            assert bench.registers[BASES[axis] + register] == expected
            assert bench.registers[BASES[1 - axis] + register] == other


TRIAL_LIMITS = (0x2010, 0x2810)


def limits_mv(bench, axis):
    """The largest voltages of the law and of braking, by what errors and gains they come from."""
    registers, base = bench.registers, BASES[axis]
    law = registers[base + s.ERROR_LIMIT] * registers[base + s.GAIN]
    brake = registers[base + s.BRAKE_LIMIT] * registers[base + s.BRAKE_GAIN]
    return [round(each / 16_000, -2) for each in (law, brake)]


def on_trial(axis=1, limit_mv=2_400):
    bench = Bench()
    bench.control(axis, *UP[:2])
    bench.write(TRIAL_LIMITS[axis], limit_mv)
    return bench


def test_trial_limit_holds_while_the_axis_is_driven_and_brakes():
    bench = on_trial()
    assert limits_mv(bench, 1) == [2_400, 2_400]
    assert limits_mv(bench, 0) == [24_000, 24_000]
    bench.control(1, UP[2])
    assert limits_mv(bench, 1) == [2_400, 2_400]
    # A setting that is written meanwhile does not lift it.
    bench.write(0x2800, 12_000)
    bench.axes.fall_silent(CODE)
    assert bench.modes()[1] == s.BRAKE
    assert limits_mv(bench, 1) == [2_400, 2_400]


def test_trial_limit_is_gone_however_the_axis_goes_off():
    ways = (
        lambda bench: bench.control(1, cia402.DISABLE_VOLTAGE),
        lambda bench: bench.axes.switch_off(),
        lambda bench: bench.axes.cut(),
        lambda bench: bench.axes.fail(CODE),
        lambda bench: bench.axes.reset(),
    )
    for leave in ways:
        for words in ((), UP[2:]):
            bench = on_trial()
            bench.control(1, *words)
            leave(bench)
            assert limits_mv(bench, 1) == [24_000, 24_000]
            assert bench.objects.read(0x2810, 0) == bytes(4)
            assert bench.objects.read(0x2802, 0) == (24_000).to_bytes(4, "little")


def test_trial_limit_binds_no_later_enabling():
    for word in (cia402.SWITCH_ON, cia402.SHUTDOWN):
        bench = on_trial()
        bench.control(1, UP[2], word)
        assert bench.objects.read(0x2810, 0) == bytes(4)
        bench.control(1, *UP[1:])
        assert bench.modes()[1] == s.RUN
        assert limits_mv(bench, 1) == [24_000, 24_000]


def test_trial_limit_outlives_a_step_back_on_the_way_and_0_ends_it():
    bench = on_trial()
    bench.control(1, cia402.SHUTDOWN)
    assert limits_mv(bench, 1) == [2_400, 2_400]
    bench.write(0x2810, 0)
    assert limits_mv(bench, 1) == [24_000, 24_000]


def test_trial_limit_above_the_limit_that_is_set_changes_nothing():
    bench = Bench()
    bench.write(0x2002, 1_000)
    bench.control(0, *UP[:2])
    bench.write(0x2010, 2_400)
    assert limits_mv(bench, 0) == [1_000, 1_000]


def test_trial_limit_is_taken_only_on_the_way_to_enabling():
    for words in ((), UP):
        bench = Bench()
        bench.control(1, *words)
        assert code_of(bench.write, 0x2810, 2_400) == sdo.WRONG_STATE
        assert limits_mv(bench, 1) == [24_000, 24_000]


class Interrupted:
    """Registers with a tick at the next read of one of them, once."""

    def __init__(self, registers, place, tick):
        self._registers = registers
        self._place = place
        self._tick = tick

    def __getitem__(self, place):
        value = self._registers[place]
        if place == self._place:
            self._place = -1
            self._tick()
        return value


def test_position_is_whole_where_a_tick_comes_amid_its_read():
    for place in (s.TURNS, s.LAST_COUNT):
        for before, after in ((0xFFFF, 0x0000), (0x0000, 0xFFFF)):
            bench = Bench()
            bench.registers[s.COUNT] = before
            s.step(bench.registers)
            step = -1 if before == 0 else 1
            start = int.from_bytes(bench.objects.read(0x6063, 0), "little")

            def tick(bench=bench, after=after):
                bench.registers[s.COUNT] = after
                s.step(bench.registers)

            axis = bench.axes._axes[0]
            axis._registers = Interrupted(bench.registers, place, tick)
            position = int.from_bytes(bench.objects.read(0x6063, 0), "little")
            assert position in (start, start + step & 0xFFFFFFFF), (place, before)


def test_smallest_limit_of_the_current_is_watched_too():
    for max_current, rated_ma in ((0, 2_000), (999, 1)):
        bench = Bench()
        bench.write(0x6073, max_current)
        bench.write(0x6075, rated_ma)
        bench.registers[s.CURRENT] = 2
        for _ in range(100):
            s.step(bench.registers)
        bench.axes.poll()
        assert bench.errors == {1: 0x2310}, max_current


def test_current_is_told_in_thousandths_of_the_rated_one_as_far_as_they_go():
    bench = Bench()
    most, least = (65_534, 65_536), (-65_536, -65_538)
    told = [(1_000, 500), (-1_000, -500), (0, 0)]
    told += [(current_ma, 32_767) for current_ma in most]
    told += [(current_ma, -32_768) for current_ma in least]
    for current_ma, per_mille in told:
        bench.registers[s.CURRENT] = current_ma
        value = int.from_bytes(bench.objects.read(0x6078, 0), "little")
        assert value == per_mille & 0xFFFF


def test_reading_of_an_encoder_stays_as_it_is_while_its_wheel_is_driven_or_held():
    """Counts that suddenly mean the other direction would have the wheel at full voltage."""
    words = (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION, cia402.QUICK_STOP)
    for count in (2, 3, 4):
        bench = Bench()
        bench.control(1, *words[:count])
        registers = list(bench.registers)
        assert code_of(bench.write, 0x687E, 0x40) == sdo.WRONG_STATE
        assert code_of(bench.write, 0x2801, 1_000) == sdo.WRONG_STATE
        assert list(bench.registers) == registers
        assert bench.objects.read(0x687E, 0) == bytes(1)
        bench.write(0x607E, 0x40)
        bench.control(1, 0)
        bench.write(0x687E, 0x40)
        assert bench.registers[s.AXIS + s.INVERTED] == 1


def test_times_are_counted_in_ticks_of_a_millisecond():
    registers = array("i", [0] * s.REGISTERS)
    tuning.set_times(registers, 60_000, 5_001)
    assert (registers[s.AGE_LIMIT], registers[s.BRAKE_TICKS]) == (60_000, 5_001)
