"""Rows of the fail-safe table about frames of the bus, or their absence; on MicroPython."""

import world
from bench import NODE
from fail_safe_bench import RESET, TARGET, UP, brakes, comes_back, cut, emergencies, keep


def set_reaction(bench, option):
    """Set the reaction of the wheels to a silent host: 0x605E."""
    for index in (0x605E, 0x685E):
        write = b"\x2b" + index.to_bytes(2, "little") + bytes((0, option, 0, 0, 0))
        bench.can.deliver(0x600 + NODE, write)
        bench.pass_ms(2)


def stale_setpoint(bench):
    # 8 m/s2 from 0.1 m/s: 13 ms
    keep(bench, 100)
    bench.target(TARGET)
    for _ in range(51):
        bench.pass_ms()
        assert not bench.off()
    brakes(bench, 14)
    assert emergencies() == [0x8250, 0x8250], emergencies()
    comes_back(bench, *RESET)


def stale_setpoint_cut(bench):
    set_reaction(bench, 0)
    keep(bench, 100)
    bench.target(TARGET)
    bench.pass_ms()
    cut(bench, 51)
    bench.pass_ms(10)
    assert emergencies() == [0x8250, 0x8250], emergencies()
    comes_back(bench, *RESET)


def fault_while_braking(bench):
    # A ramp of 0.1 m/s2 would last for a second.
    for index in (0x6085, 0x6885):
        write = b"\x23" + index.to_bytes(2, "little") + b"\0" + (100_000).to_bytes(4, "little")
        bench.can.deliver(0x600 + NODE, write)
        bench.pass_ms(2)
    bench.target(TARGET)
    bench.pass_ms(60)
    assert not bench.off()
    world.levels[bench.fault] = 0
    for _ in range(99):
        bench.pass_ms()
        assert not bench.off()
    cut(bench)
    bench.pass_ms(10)
    assert 0x2310 in emergencies()
    world.levels[bench.fault] = 1
    comes_back(bench, *RESET)


def no_sync(bench):
    for _ in range(80):
        bench.can.deliver(0x200 + NODE, TARGET.to_bytes(4, "little") * 2)
        bench.pass_ms()
    assert bench.off()
    bench.pass_ms(320)
    comes_back(bench, *RESET)


def heartbeat_lost(bench):
    # 0x1016:1 = node 100, 40 ms
    bench.can.deliver(0x600 + NODE, b"\x23\x16\x10\x01" + (100 << 16 | 40).to_bytes(4, "little"))
    for _ in range(100):
        bench.can.deliver(0x764, b"\x05")
        keep(bench, 1)
    silent_ms = 0
    full = bench.widths()
    while bench.widths() == full:
        bench.target(TARGET)
        bench.pass_ms()
        silent_ms += 1
    assert 39 <= silent_ms <= 46, silent_ms
    brakes(bench, 14)
    assert 0x8130 in emergencies()
    # It is missed no more, and the node is started again.
    bench.can.deliver(0x600 + NODE, b"\x23\x16\x10\x01\0\0\0\0")
    bench.pass_ms(2)
    bench.can.deliver(0x000, bytes((1, NODE)))
    bench.pass_ms(2)
    comes_back(bench, *RESET)


def bus_off(bench):
    keep(bench, 20)
    bench.can.fall_silent()
    cut(bench)
    bench.pass_ms(150)
    assert 0x8140 in emergencies()
    comes_back(bench, *RESET)


def shorted_bus(bench):
    for each in (world.buses, world.timers):
        each.clear()
    receive = bench.can.RECEIVE_PIN
    world.levels[receive] = 0
    for ms in range(350):
        world.events[world.now_ms + ms] = lambda: world.told.append(bench.off())
    world.events[world.now_ms + 350] = lambda: world.levels.update({receive: 1})
    world.told.clear()
    board = bench.module.board()
    assert world.told.count(True) in {0, 349}, "a bxCAN waits, others do not"
    assert False not in world.told
    assert bench.off()
    assert board.bus.off is False


def leaving_operational(bench):
    for command in (0x80, 0x02, 0x81, 0x82):
        bench.can.deliver(0x000, bytes((command, NODE)))
        bench.runner.turn(world.now_ms)
        cut(bench)
        if command in (0x81, 0x82):
            bench.pass_ms(2000)
        bench.can.deliver(0x000, bytes((1, NODE)))
        bench.pass_ms(2)
        comes_back(bench, 0x00, *UP)


def taken_node_id(bench):
    bench.can.deliver(0x700 + NODE, b"\x05")
    bench.runner.turn(world.now_ms)
    cut(bench)
    bench.pass_ms(10)
    assert 0x8150 in emergencies()
    # The other has gone, and the node claims its id anew.
    bench.can.deliver(0x000, bytes((0x82, NODE)))
    bench.pass_ms(2000)
    bench.can.deliver(0x000, bytes((1, NODE)))
    bench.pass_ms(2)
    comes_back(bench, *RESET)


def place_code(bench, *bits):
    """Jumpers of the table's connector pull these bits low."""
    for bit, pin in enumerate(bench.module.PINS.place):
        world.levels[pin] = 0 if bit in bits else 1


def in_anothers_place(bench):
    place_code(bench, 1, 2)  # here belongs node 6
    keep(bench, 20)
    bench.can.deliver(0x000, bytes((0x81, NODE)))
    bench.runner.turn(world.now_ms)
    cut(bench)
    bench.pass_ms(2000)
    assert emergencies() == [0xFF02]
    for _ in range(2):
        bench.can.deliver(0x000, bytes((1, NODE)))
        bench.pass_ms(2)
        for word in UP:
            bench.can.deliver(0x300 + NODE, bytes((word, 0, word, 0)))
            bench.can.deliver(0x600 + NODE, bytes((0x2B, 0x40, 0x60, 0, word, 0, 0, 0)))
            bench.pass_ms()
        for _ in range(30):
            bench.target(TARGET)
            bench.pass_ms()
            assert bench.off()
    assert emergencies() == [0xFF02] * 3
    assert [data[4] for can_id, data in world.sent if can_id == 0x080 + NODE] == [6] * 3
    # Parity makes the jumpers of 4 and of 32 two. With one alone a place is that of no node.
    for bits, told in (((2, 6), 4), ((5, 6), 32), ((0,), 255), ((6,), 255), ((0, 1, 2), 255)):
        place_code(bench, *bits)
        world.sent.clear()
        bench.can.deliver(0x000, bytes((1, NODE)))
        bench.pass_ms(2)
        assert [data[4] for can_id, data in world.sent if can_id == 0x080 + NODE] == [told]
    # It is put back, under power even.
    place_code(bench, 0, 2)
    bench.can.deliver(0x000, bytes((1, NODE)))
    bench.pass_ms(2)
    assert emergencies()[-1] == 0
    comes_back(bench, 0x00, *UP)


def enabled_before_operational(bench):
    bench.can.deliver(0x000, bytes((0x80, NODE)))
    for word in UP:
        bench.can.deliver(0x600 + NODE, bytes((0x2B, 0x40, 0x60, 0, word, 0, 0, 0)))
        bench.pass_ms(2)
    bench.can.deliver(0x600 + NODE, b"\x23\xff\x60\x00" + TARGET.to_bytes(4, "little"))
    for _ in range(100):
        bench.pass_ms()
        assert bench.off()
    bench.can.deliver(0x000, bytes((1, NODE)))
    for _ in range(100):
        bench.pass_ms()
        assert bench.off()
    comes_back(bench, 0x00, *UP)


CLEAR = b"\x2f\x51\x1f\x01\x03\0\0\0"


def answer(bench, request):
    """The cell's answer to an SDO request, while targets go on."""
    world.sent.clear()
    bench.can.deliver(0x600 + NODE, request)
    keep_targets(bench, 5)
    return [data for can_id, data in world.sent if can_id == 0x580 + NODE][-1]


def keep_targets(bench, ms):
    for _ in range(ms):
        bench.target(TARGET)
        bench.pass_ms()


def update_while_driving(bench):
    refused = answer(bench, CLEAR)
    code = b"\x22\0\0\x08" if bench.board.slots else b"\x20\0\0\x08"
    assert refused == b"\x80\x51\x1f\x01" + code
    assert not bench.off()
    keep(bench, 50)


def enabled_while_updating(bench):
    bench.can.deliver(0x300 + NODE, bytes(4))
    bench.pass_ms(3_000)  # the wheels stand, and the bridges sleep
    room = bench.board.slots is not None
    assert answer(bench, CLEAR)[0] == (0x60 if room else 0x80)
    begun = answer(bench, b"\xc2\x50\x1f\x01\x00\x10\0\0")
    assert begun[0] == (0xA4 if room else 0x80)
    for word in UP:
        bench.can.deliver(0x300 + NODE, bytes((word, 0, word, 0)))
        bench.pass_ms()
    for _ in range(100):
        bench.target(TARGET)
        bench.pass_ms()
        assert bench.off() or not room
    if room:
        bench.pass_ms(1_000)  # the client is silent, and the transfer over
        comes_back(bench, *UP)
