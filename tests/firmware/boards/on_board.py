"""A board from start to stop, seen in its faked peripherals; runs on MicroPython."""

import binascii

import micropython
import stm
import world
from bench import NODE, Bench

import main
from boards import detect, start
from mdms_cell.drive import speed_loop as s


def test_is_made_with_everything_off(bench):
    assert ("can", 1, 1_000_000) in world.told
    assert bench.off()
    assert not world.levels[bench.wake]
    if bench.name == "teensy41":
        assert ("encoder", 0, "D2", "D3") in world.told
        assert ("encoder", 1, "D7", "D8") in world.told
        assert [each[1:] for each in world.told if each[0] == "pwm"] == [
            (pin, 20_000) for pin in bench.pulses
        ]
        return
    pwm = bench.pulses[0][0]
    channels = [each[1:4] for each in world.told if each[0] == "channel"]
    assert sorted(channels) == sorted(
        [(pwm, 1, 0), (pwm, 2, 0)]
        + [(timer, channel, 11) for timer in bench.encoders for channel in (1, 2)]
    )
    assert world.periods[pwm] == bench.full - 1


def test_spikes_on_an_encoders_wires_are_filtered_out(bench):
    if bench.name == "teensy41":
        return
    for timer in bench.encoders:
        inputs = world.registers[stm.TIMERS[timer] + stm.TIM_CCMR1]
        # Both inputs count, with the longest filter.
        assert inputs == 0xF1F1, hex(inputs)


def test_bits_are_read_as_near_to_seven_eighths_as_the_clock_allows(bench):
    can = bench.can

    def off(segments):
        return abs(8 * (1 + segments[0]) - 7 * (1 + sum(segments))) / (1 + sum(segments))

    allowed = [
        segments
        for prescaler, *segments in can.timings(1_000_000)
        if prescaler * (1 + sum(segments)) * 1_000_000 == can.CLOCK_HZ
        and segments[1] >= can.PROCESSING_QUANTA
    ]
    assert list(can.segments) in allowed
    assert off(can.segments) == min([off(segments) for segments in allowed]), can.segments


def test_has_a_serial_number_that_every_byte_of_the_chips_own_counts_for(bench):
    own = bytes(range(12))
    assert bench.board.serial == binascii.crc32(own)


def test_room_for_an_exception_is_made_before_any_interrupt(bench):
    bench.boot()
    started = [each[0] for each in world.told if each[0] in ("exception buffer", "timer")]
    assert started[0] == "exception buffer"


def test_boots_and_drives_both_wheels(bench):
    bench.boot()
    assert [each[2] for each in world.told if each[0] == "timer"] == [1000]
    assert bench.off()
    bench.drive(100_000)
    assert world.levels[bench.wake]
    # V = 13 V s/m * 0.1 m/s = 1.3 V out of 24 V
    for width in bench.widths():
        assert abs(width - bench.full * 13 // 240) <= 2 + bench.full // 1000, width
    assert (world.levels[bench.phases[0]], world.levels[bench.phases[1]]) == (1, 0)


def test_an_error_before_the_first_turn_is_logged_with_the_motors_off(bench):
    def no_memory(_board, _node_id):
        raise MemoryError("memory allocation failed")

    start.Cell = no_memory
    try:
        start.run(bench.board, None, ".", NODE)
    except MemoryError:
        world.told.append("ended")
    assert world.told[-1] == "ended"
    assert bench.off()
    assert not world.levels[bench.wake]
    with open("crash.log") as file:
        assert file.read().endswith("MemoryError: memory allocation failed\n")


def test_a_board_that_cannot_be_made_is_logged_with_the_motors_off(bench):
    def no_bus(_board, _pins):
        raise OSError("no CAN")

    type(bench.board).connected = no_bus
    detect.board_module = lambda _machine: bench.module
    main.ROOT = "."
    # As a reset of MicroPython alone may leave it.
    world.levels[bench.wake] = 1
    try:
        main.begin(None)
    except OSError:
        world.told.append("ended")
    assert world.told[-1] == "ended"
    assert bench.widths() == (0, 0)
    assert not world.levels[bench.wake]
    with open("crash.log") as file:
        assert file.read().endswith("OSError: no CAN\n")


def test_both_leds_blink_together_while_the_board_is_the_one_meant(bench):
    bench.boot()
    leds = (bench.module.PINS.run_led, bench.module.PINS.error_led)
    bench.can.deliver(0x600 + NODE, b"\x2b\x07\x30\x00\xf4\x01\x00\x00")
    seen = set()
    for _ in range(400):
        bench.pass_ms()
        seen.add((world.levels[leds[0]], world.levels[leds[1]]))
    assert seen == {(0, 0), (1, 1)}, seen
    bench.pass_ms(200)
    assert not world.levels[leds[1]]


def test_reports_the_free_heap_and_flash(bench):
    assert 0 < bench.board.heap_free() < 1 << 31
    assert 0 <= bench.board.flash_free() < 1 << 31


def test_full_voltage_is_a_full_pulse(bench):
    bench.boot()
    bench.drive(10_000_000)
    assert bench.widths()[0] >= bench.full - 3
    assert bench.widths()[0] <= bench.full


def test_measures_speed_and_current_and_supply(bench):
    bench.boot()
    bench.drive(100_000)
    registers = bench.board.registers
    for tick in range(100):
        world.counts[bench.encoders[0]] = 65500 + 3 * tick
        world.counts[bench.encoders[1]] = -3 * tick
        bench.target(100_000)
        world.analog[bench.currents[1]] = 65536 // 3
        bench.pass_ms()
    assert abs(registers[s.ACTUAL] - 3_000_000_000 // 37_595) < 200
    assert abs(registers[s.AXIS + s.ACTUAL] + 3_000_000_000 // 37_595) < 200
    assert abs(abs(registers[s.AXIS + s.CURRENT]) - 1_000) < 2
    assert abs(registers[s.SUPPLY] - 24_000_000) < 10_000


def test_wheel_may_turn_as_far_as_it_likes_either_way(bench):
    bench.boot()
    for count in (65_535, 65_536, 1 << 30, (1 << 31) - 1, -1, -65_537, -(1 << 31)):
        for encoder in bench.encoders:
            world.counts[encoder] = count
        bench.cell.tick()
        assert bench.board.registers[s.COUNT] == count & 0xFFFF
        assert bench.board.registers[s.AXIS + s.COUNT] == count & 0xFFFF


def test_watchdog_is_patient_while_the_bridges_sleep(bench):
    bench.boot()
    assert watchdogs() == [5000]
    bench.drive(100_000)
    awake_ms = 500 if bench.name == "teensy41" else 250
    assert watchdogs() == [5000, awake_ms]
    bench.can.deliver(0x000, bytes((2, NODE)))
    bench.pass_ms(2)
    assert bench.off()
    assert watchdogs() == [5000, awake_ms]
    bench.pass_ms(900)
    assert watchdogs() == [5000, awake_ms, 5000]


def watchdogs():
    return [each[1] for each in world.told if each[0] == "watchdog"]


def test_tick_allocates_nothing(bench):
    bench.boot()
    bench.drive(-100_000)
    world.analog[bench.supply] = world.analog[bench.currents[0]] = 65535
    world.levels[bench.fault] = 0
    micropython.heap_lock()
    for _ in range(10):
        bench.cell.tick()
    micropython.heap_unlock()
    assert not bench.off()


def test_current_is_known_in_the_tick_that_reads_it(bench):
    bench.boot()
    bench.drive(100_000)
    world.analog[bench.currents[0]] = 65536 // 2
    world.advance()
    assert bench.board.registers[s.CURRENT] == 1_500
    assert bench.board.registers[s.AXIS + s.CURRENT] == 0
    world.levels[bench.fault] = 0
    world.advance()
    assert bench.board.registers[s.CURRENT] > 3_000
    assert bench.board.registers[s.AXIS + s.CURRENT] > 3_000


def test_background_never_touches_the_converter_that_the_tick_uses(bench):
    bench.boot()
    before = world.conversions
    bench.runner.turn(world.now_ms)
    assert world.conversions == before
    world.advance()
    assert world.conversions == before + 3


def test_voltage_is_zero_within_a_tick_of_too_much_current(bench):
    bench.boot()
    # 0x2006 and 0x2806: over-current time 1 ms
    for index in (0x20, 0x28):
        bench.can.deliver(0x600 + NODE, bytes((0x2B, 0x06, index, 0, 1, 0, 0, 0)))
        bench.pass_ms()
    bench.drive(100_000)
    world.analog[bench.currents[0]] = 65535
    world.advance()  # one tick, no background
    assert bench.widths()[0] == 0
    assert bench.widths()[1] != 0
    world.levels[bench.fault] = 0
    world.advance()
    assert bench.widths() == (0, 0)


def test_fault_of_a_bridge_counts_at_any_limit_of_the_current(bench):
    bench.boot()
    # 0x6075 and 0x6073 at their largest: 1,000 A
    for index in (0x60, 0x68):
        rated = bytes((0x23, 0x75, index, 0)) + (100_000).to_bytes(4, "little")
        bench.can.deliver(0x600 + NODE, rated)
        bench.pass_ms()
        largest = bytes((0x2B, 0x73, index, 0)) + (10_000).to_bytes(2, "little") + bytes(2)
        bench.can.deliver(0x600 + NODE, largest)
        bench.pass_ms()
    bench.drive(100_000)
    world.levels[bench.fault] = 0
    for _ in range(110):
        bench.target(100_000)
        bench.pass_ms()
    assert bench.off()


def test_presence_follows_the_sensors(bench):
    bench.boot()
    assert bench.board.presence() == 0
    world.levels[bench.sensors[0]] = 0
    world.levels[bench.sensors[4]] = 0
    assert bench.board.presence() == 0b10001


def test_stop_ends_timer_and_bus_and_drive(bench):
    bench.boot()
    bench.drive(100_000)
    bench.board.stop()
    assert bench.off()
    tick = bench.board.registers[s.TICKS]
    world.advance()
    bench.can.deliver(0x000, bytes((1, NODE)))
    assert bench.board.registers[s.TICKS] == tick
    assert bench.board.inbox.peek() is None


def run(board, name):
    bench = Bench(board)
    globals()[name](bench)
    print("done")
