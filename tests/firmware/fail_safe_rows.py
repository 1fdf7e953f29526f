"""Every row of the fail-safe table in firmware/README.md; runs on MicroPython.

`bench` drives both wheels at 1.3 V when a row begins. `cut(bench)` asserts that no later tick than
the next one has taken the voltage away, with no turn of the background in between.
"""

import world
from bench import NODE, SUPPLY_24_V, Bench

from boards import start
from mdms_cell.drive import speed_loop as s
from mdms_protocol import cia402
from mdms_protocol.version import VERSION

TARGET = 100_000


def cut(bench, ticks=1):
    assert not bench.off(), "the motors were off before"
    for _ in range(ticks):
        assert not bench.off(), "the motors were off too early"
        world.advance()
    assert bench.off(), "the motors are still on"


def keep(bench, ms):
    """Stream targets for a while; both motors must stay on."""
    for _ in range(ms):
        bench.target(TARGET)
        bench.pass_ms()
        assert not bench.off()


def brakes(bench, ms, hold_ms=300):
    """The wheels are ramped to rest within so many ticks, and stay there, whatever is commanded.

    These stand from the beginning, so that the braking gain shows as more voltage at first.
    """
    world.advance()
    before = bench.widths()
    for _ in range(ms - 1):
        world.advance()
        assert all(now <= then for now, then in zip(bench.widths(), before))  # noqa: B905
        before = bench.widths()
    assert before == (0, 0)
    assert world.levels[bench.wake]
    for _ in range(hold_ms):
        bench.target(TARGET)
        bench.pass_ms()
        assert bench.off()


def falls(bench, ms, code):
    """Stream targets for so long; the first motor is off then, and the host is told why."""
    for _ in range(ms):
        bench.target(TARGET)
        bench.pass_ms()
    assert bench.widths()[0] == 0
    bench.pass_ms(10)
    assert code in emergencies()


def emergencies():
    codes = []
    for can_id, data in world.sent:
        if can_id == 0x080 + NODE:
            codes.append(data[0] | data[1] << 8)
    return codes


def comes_back(bench, *controlwords):
    """Fault reset, the way up and a new target make the wheels turn again; nothing less does."""
    bench.target(TARGET)
    bench.pass_ms(10)
    assert bench.off()
    for word in controlwords:
        bench.can.deliver(0x300 + NODE, bytes((word, 0, word, 0)))
        bench.pass_ms()
    # Without a new target the wheel stands, SYNC or not.
    for _ in range(30):
        bench.can.deliver(0x080, b"")
        bench.pass_ms()
        assert bench.off()
    bench.target(TARGET)
    bench.pass_ms(3)
    keep(bench, 20)


def set_reaction(bench, option):
    """What a silent host makes the wheels do: 0x605E."""
    for index in (0x605E, 0x685E):
        write = b"\x2b" + index.to_bytes(2, "little") + bytes((0, option, 0, 0, 0))
        bench.can.deliver(0x600 + NODE, write)
        bench.pass_ms(2)


RESET = (0x00, cia402.FAULT_RESET, cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)
UP = RESET[2:]


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


def exception_in_tick(bench):
    world.analog[bench.supply] = None  # no number to reckon with
    cut(bench)
    try:
        bench.pass_ms()
    except TypeError:
        return
    raise AssertionError("the background was not told")


def ends(bench, action, wanted):
    """Run the program itself on the bench's board, wheels driven, until `action` ends it."""
    start_ms = world.now_ms + 1500
    frames = [(0x000, bytes((1, NODE)))]
    frames += [(0x300 + NODE, bytes((word, 0, word, 0))) for word in UP]
    for place, frame in enumerate(frames):
        world.events[start_ms + place] = lambda frame=frame: bench.can.deliver(*frame)
    for ms in range(start_ms + len(frames), start_ms + 50):
        world.events[ms] = lambda: bench.target(TARGET)

    def plan():
        assert not bench.off()
        bench.board.show = action

    world.events[start_ms + 50] = plan
    try:
        start.run(bench.board, None, ".", NODE, watchdog=False)
    except wanted:
        world.told.append("ended")
    assert world.told[-1] == "ended"
    assert bench.off()
    assert 0x6100 in emergencies()
    with open("crash.log") as file:
        log = file.read()
    assert log.startswith("mdms " + VERSION + "\nTraceback")
    assert wanted.__name__ in log


def exception_in_background(bench):
    ends(bench, lambda now_ms, state, faulty: 1 // 0, ZeroDivisionError)


def interrupted_from_prompt(bench):
    def interrupt(now_ms, state, faulty):
        raise KeyboardInterrupt

    ends(bench, interrupt, KeyboardInterrupt)


def timer_dies(bench):
    fed_ms = world.fed_ms
    keep(bench, 5)
    assert world.fed_ms > fed_ms
    world.timers.clear()
    fed_ms = world.fed_ms
    for _ in range(50):
        bench.pass_ms()
    assert world.fed_ms <= fed_ms + 1


def background_hangs(bench):
    bench.target(TARGET)
    bench.pass_ms()
    fed_ms = world.fed_ms
    for _ in range(50):
        world.advance()
        assert not bench.off()
    for _ in range(14):
        world.advance()
    assert bench.off()
    assert world.fed_ms == fed_ms
    bench.pass_ms(320)
    comes_back(bench, *RESET)


def start_up(bench):
    fresh = bench.board
    fresh.registers[s.MODE] = s.OFF
    bench.pass_ms(0)
    bench.can.deliver(0x000, bytes((0x81, NODE)))
    bench.runner.turn(world.now_ms)
    for _ in range(500):
        bench.target(TARGET)
        bench.pass_ms()
    assert bench.off()
    bench.can.deliver(0x000, bytes((1, NODE)))
    bench.pass_ms(2)
    comes_back(bench, 0x00, *UP)


CLEAR = b"\x2f\x51\x1f\x01\x03\0\0\0"


def answer(bench, request):
    """What the cell answers to an SDO request, while targets go on."""
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


def run(name, board):
    bench = Bench(board)
    bench.boot()
    bench.drive(TARGET)
    assert not bench.off()
    world.sent.clear()
    globals()[name](bench)
    print("done")
