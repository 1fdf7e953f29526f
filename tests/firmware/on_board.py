"""What a board does from start to stop, told by its faked peripherals; runs on MicroPython."""

import binascii

import micropython
import world
from bench import NODE, Bench

from mdms_cell.drive import speed_loop as s

FULL = {12: 4200, 2: 8500}


def test_is_made_with_everything_off(bench):
    assert ("can", 1, 1_000_000) in world.told
    assert bench.off()
    assert not world.levels[bench.wake]
    channels = [each[1:4] for each in world.told if each[0] == "channel"]
    assert sorted(channels) == sorted(
        [(bench.pwm, 1, 0), (bench.pwm, 2, 0)]
        + [(timer, channel, 11) for timer in bench.encoders for channel in (1, 2)]
    )
    assert world.periods[bench.pwm] == FULL[bench.pwm] - 1


def test_has_a_serial_number_that_every_byte_of_the_chips_own_counts_for(bench):
    own = bytes(range(12))
    assert bench.board.serial == binascii.crc32(own)


def test_boots_and_drives_both_wheels(bench):
    bench.boot()
    assert ("timer", 7, 1000) in world.told
    assert bench.off()
    bench.drive(100_000)
    assert world.levels[bench.wake]
    # V = 13 V s/m * 0.1 m/s = 1.3 V out of 24 V
    for width in bench.widths():
        assert abs(width - FULL[bench.pwm] * 13 // 240) <= 2, width
    assert (world.levels[bench.phases[0]], world.levels[bench.phases[1]]) == (1, 0)


def test_full_voltage_is_a_full_pulse(bench):
    bench.boot()
    bench.drive(10_000_000)
    assert bench.widths()[0] >= FULL[bench.pwm] - 3
    assert bench.widths()[0] <= FULL[bench.pwm]


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


def test_watchdog_is_patient_while_the_bridges_sleep(bench):
    bench.boot()
    assert watchdogs() == [5000]
    bench.drive(100_000)
    assert watchdogs() == [5000, 250]
    bench.can.deliver(0x000, bytes((2, NODE)))
    bench.pass_ms(2)
    assert bench.off()
    assert watchdogs() == [5000, 250]
    bench.pass_ms(600)
    assert watchdogs() == [5000, 250, 5000]


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


def test_presence_follows_the_sensors(bench):
    bench.boot()
    assert bench.board.presence() == 0
    world.levels[bench.sensors[0]] = 0
    world.levels[bench.sensors[4]] = 0
    assert bench.board.presence() == 0b10001


def test_bus_off_cuts_the_motors_and_the_bus_comes_back(bench):
    bench.boot()
    bench.drive(100_000)
    assert not bench.off()
    bench.can.fall_silent()
    world.advance()  # one tick, no background
    assert bench.off()
    bench.pass_ms(90)
    assert bench.can.restarts == 0
    world.sent.clear()
    bench.pass_ms(30)
    assert bench.can.restarts == 1
    bench.pass_ms(20)
    emergencies = [data for can_id, data in world.sent if can_id == 0x080 + NODE]
    assert emergencies
    assert emergencies[0][:2] == b"\x40\x81"
    assert bench.off()
    world.levels[bench.wake] = 0
    for word in (0x80, 0x06, 0x07, 0x0F):
        bench.can.deliver(0x300 + NODE, bytes((word, 0, word, 0)))
        bench.pass_ms()
    bench.target(100_000)
    bench.pass_ms(3)
    assert not bench.off()


def test_bus_that_stays_off_is_tried_again_and_again(bench):
    bench.boot()
    bench.can.fall_silent()
    bench.pass_ms(150)
    bench.can.fall_silent()
    bench.pass_ms(150)
    assert bench.can.restarts == 2


def test_more_frames_than_mailboxes_leave_in_their_order(bench):
    bench.boot()
    bench.pass_ms(5)
    world.sent.clear()
    frames = [(0x181, bytes((place,))) for place in range(10)]
    for can_id, data in frames:
        assert bench.board.send(can_id, data)
    bench.pass_ms(20)
    assert [frame for frame in world.sent if frame[0] == 0x181] == frames


def test_full_outbox_refuses(bench):
    bench.can.fall_silent()
    bench.board.service(0)
    assert all(bench.board.send(0x181, b"") for _ in range(32))
    assert not bench.board.send(0x181, b"")


def test_remote_and_extended_frames_are_dropped(bench):
    bench.boot()
    before = bench.cell.received
    bench.can.deliver(0x000, bytes((1, NODE)), 1)
    bench.can.deliver(0x000, bytes((1, NODE)), 2)
    bench.pass_ms(2)
    assert bench.cell.received == before


def test_identifiers_of_others_are_filtered(bench):
    bench.boot()
    assert not bench.can.deliver(0x206, bytes(8))
    assert bench.can.deliver(0x200 + NODE, bytes(8))


def test_all_that_a_cell_listens_to_comes_into_the_first_fifo(bench):
    bench.boot()
    for count in range(1, 40):
        identifiers = [(can_id * 53 + count * 7) % 0x7E0 for can_id in range(count)]
        bench.board.listen(identifiers)
        filters = bench.can.filters
        assert len(filters) <= 14
        for can_id in identifiers:
            assert bench.can.fifo_of(can_id) == 0
        others = [can_id for can_id in range(0x7E0) if can_id not in identifiers]
        through = sum(bench.can.fifo_of(can_id) is not None for can_id in others)
        assert through == 0 or count > 7
        assert all(bench.can.fifo_of(can_id) != 1 for can_id in others)


def test_filters_of_an_ordinary_cell_let_hardly_anything_else_through(bench):
    node, host = 5, 0x7E
    own = [0x000, 0x080, 0x7E5, 0x700 + host]
    own += [base + node for base in (0x180, 0x200, 0x280, 0x300, 0x580, 0x600, 0x700)]
    bench.board.listen(own)
    others = [base + other for base in range(0x080, 0x780, 0x80) for other in range(6, 19)]
    assert not any(bench.can.deliver(can_id, b"") for can_id in others)


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
