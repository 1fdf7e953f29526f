"""Rows of the fail-safe table about wheels, their bridges and supply, and stops; on MicroPython."""

import world
from bench import NODE, SUPPLY_24_V
from fail_safe_bench import RESET, TARGET, UP, comes_back, cut, emergencies, keep


def falls(bench, ms, code):
    """Stream targets for so long; the first motor is off then, and the host is told why."""
    for _ in range(ms):
        bench.target(TARGET)
        bench.pass_ms()
    assert bench.widths()[0] == 0
    bench.pass_ms(10)
    assert code in emergencies()


def undervoltage(bench):
    # The relay of the emergency stop opens, and closes again 50 ms later.
    keep(bench, 50)
    world.analog[bench.supply] = 0
    for _ in range(5):
        bench.target(TARGET)
        world.advance()
        assert bench.off()
    bench.runner.turn(world.now_ms)
    bench.pass_ms(10)
    assert emergencies() == [0x3220, 0x3220], emergencies()
    bench.can.deliver(0x600 + NODE, b"\x40\x79\x60\x00\0\0\0\0")
    bench.pass_ms(2)
    assert (0x580 + NODE, b"\x43\x79\x60\x00\0\0\0\0") in world.sent
    bench.pass_ms(40)
    world.analog[bench.supply] = SUPPLY_24_V
    for _ in range(300):
        bench.target(TARGET)
        bench.pass_ms()
        assert bench.off()
    comes_back(bench, *RESET)


def undervoltage_switched_on(bench):
    # As `undervoltage`, while the drives wait in 'switched on'.
    for word in (0x00, UP[0], UP[1]):
        bench.can.deliver(0x300 + NODE, bytes((word, 0, word, 0)))
        bench.pass_ms()
    bench.pass_ms(20)
    assert bench.off()
    assert not emergencies()
    world.analog[bench.supply] = 0
    for _ in range(5):
        world.advance()
    world.analog[bench.supply] = SUPPLY_24_V
    bench.pass_ms(10)
    assert emergencies() == [0x3220, 0x3220], emergencies()
    enable_without_reset(bench, UP[2])
    comes_back(bench, *RESET)


def undervoltage_off(bench):
    # In 'switch on disabled' and 'ready to switch on' it is no fault, and reported.
    for word in (0x00, UP[0]):
        bench.can.deliver(0x300 + NODE, bytes((word, 0, word, 0)))
        bench.pass_ms(20)
        world.sent.clear()
        world.analog[bench.supply] = 0
        bench.pass_ms(20)
        assert emergencies() == [0x3220, 0x3220], emergencies()
        world.analog[bench.supply] = SUPPLY_24_V
        for _ in range(100):
            bench.target(TARGET)
            bench.pass_ms()
            assert bench.off()
        assert emergencies() == [0x3220, 0x3220, 0, 0], emergencies()
    # Switched on while it is low, they have the fault.
    world.analog[bench.supply] = 0
    bench.pass_ms(20)
    bench.can.deliver(0x300 + NODE, bytes((UP[1], 0, UP[1], 0)))
    bench.pass_ms(20)
    world.analog[bench.supply] = SUPPLY_24_V
    bench.pass_ms(20)
    enable_without_reset(bench, UP[2])
    comes_back(bench, *RESET)


def undervoltage_after_silence(bench):
    # The host falls silent, and the relay opens and closes before it is back.
    bench.pass_ms(600)
    assert bench.off()
    assert emergencies() == [0x8250, 0x8250], emergencies()
    world.sent.clear()
    world.analog[bench.supply] = 0
    bench.pass_ms(20)
    world.analog[bench.supply] = SUPPLY_24_V
    bench.pass_ms(20)
    assert emergencies() == [0x3220, 0x3220], emergencies()
    bench.can.deliver(0x600 + NODE, b"\x40\x3f\x60\x00\0\0\0\0")
    bench.pass_ms(2)
    assert (0x580 + NODE, b"\x4b\x3f\x60\x00\x20\x32\0\0") in world.sent
    comes_back(bench, *RESET)


def stopped_after_silence(bench):
    # The host falls silent, and somebody stops all nodes before it is back.
    bench.pass_ms(60)
    bench.can.deliver(0x000, b"\x80\x00")
    bench.pass_ms(600)
    assert bench.off()
    bench.can.deliver(0x600 + NODE, b"\x40\x3f\x60\x00\0\0\0\0")
    bench.pass_ms(2)
    assert (0x580 + NODE, b"\x4b\x3f\x60\x00\x00\x90\0\0") in world.sent
    bench.can.deliver(0x000, b"\x01\x00")
    bench.pass_ms(2)
    comes_back(bench, *RESET)


def enable_without_reset(bench, word):
    """It turns no wheel of a drive that has a fault."""
    for _ in range(100):
        bench.can.deliver(0x300 + NODE, bytes((word, 0, word, 0)))
        bench.target(TARGET)
        bench.pass_ms()
        assert bench.off()


def runaway(bench):
    # The encoder counts the other way round: -0.2 m/s for a target of 0.1 m/s.
    keep(bench, 20)
    for ms in range(200):
        world.counts[bench.encoders[0]] = -8 * ms & 0xFFFF
        bench.target(TARGET)
        bench.pass_ms()
        if not bench.widths()[0]:
            break
    assert ms < 100
    bench.pass_ms(10)
    assert 0x7302 in emergencies()
    bench.can.deliver(0x300 + NODE, bytes(4))  # the other wheel has no fault
    bench.pass_ms(2)
    comes_back(bench, *RESET)


def stall(bench):
    # A held wheel under 1.3 V is a load; under 6.5 V it is a fault.
    keep(bench, 500)
    driven_ms = 0
    while bench.widths()[0]:
        bench.target(5 * TARGET)
        bench.pass_ms()
        driven_ms += 1
    assert 78 <= driven_ms < 100, driven_ms
    bench.pass_ms(10)
    assert 0x7121 in emergencies()
    comes_back(bench, *RESET)


def over_current(bench):
    keep(bench, 50)
    world.analog[bench.currents[0]] = 65535
    for _ in range(99):
        bench.target(TARGET)
        bench.pass_ms()
        assert bench.widths()[0]
    world.advance()
    assert bench.widths()[0] == 0
    assert bench.widths()[1] != 0, "the other wheel has no fault"
    bench.pass_ms(10)
    assert 0x2310 in emergencies()
    world.analog[bench.currents[0]] = 0
    bench.can.deliver(0x300 + NODE, bytes(4))  # the other wheel has no fault
    bench.pass_ms(2)
    comes_back(bench, *RESET)


def bridge_fault(bench):
    keep(bench, 50)
    world.levels[bench.fault] = 0
    keep(bench, 99)
    cut(bench)
    bench.pass_ms(10)
    assert 0x2310 in emergencies()
    world.levels[bench.fault] = 1
    comes_back(bench, *RESET)


def following_error(bench):
    # 0x60F8 max slippage 50 mm/s for 0x2007 = 20 ms
    bench.can.deliver(0x600 + NODE, b"\x2b\x07\x20\x00" + (20).to_bytes(2, "little") + b"\0\0")
    bench.pass_ms(2)
    bench.can.deliver(0x600 + NODE, b"\x23\xf8\x60\x00" + (50_000).to_bytes(4, "little"))
    bench.pass_ms(2)
    falls(bench, 25, 0x8611)
    bench.can.deliver(0x600 + NODE, b"\x23\xf8\x60\x00\0\0\0\0")
    bench.pass_ms(2)
    bench.can.deliver(0x300 + NODE, bytes(4))  # the other wheel has no fault
    bench.pass_ms(2)
    comes_back(bench, *RESET)


def disable_voltage(bench):
    bench.can.deliver(0x300 + NODE, bytes(4))
    bench.runner.turn(world.now_ms)
    cut(bench)
    comes_back(bench, *UP)


def quick_stop(bench):
    # 8 m/s2 from 0.1 m/s: 13 ms
    bench.can.deliver(0x300 + NODE, b"\x02\x00\x02\x00")
    bench.runner.turn(world.now_ms)
    before = bench.widths()[0]
    for _ in range(11):
        world.advance()
        assert 0 < bench.widths()[0] <= before
        before = bench.widths()[0]
    bench.pass_ms(12)
    assert bench.off()
    comes_back(bench, 0x00, *UP)


def quick_stop_of_a_pushed_wheel(bench):
    bench.can.deliver(0x300 + NODE, b"\x02\x00\x02\x00")
    for ms in range(4100):
        for encoder in bench.encoders:
            world.counts[encoder] = 4 * ms & 0xFFFF
        bench.pass_ms()
    assert bench.off()
    assert not world.levels[bench.wake], "time is over, and the bridges sleep"
    comes_back(bench, 0x00, *UP)


def braked(bench):
    # A wheel that turns is held at 0 V until it stands; then the bridges sleep.
    keep(bench, 20)
    count = 0
    bench.can.deliver(0x300 + NODE, bytes(4))
    for ms in range(200):
        count += 4
        world.counts[bench.encoders[0]] = count
        bench.pass_ms()
        assert ms < 2 or bench.widths() == (0, 0)
        assert world.levels[bench.wake]
    bench.pass_ms(900)
    assert not world.levels[bench.wake]
    comes_back(bench, 0x00, *UP)
