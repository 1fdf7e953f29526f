"""Functions for rows of the fail-safe table; `bench` drives both wheels at 1.3 V as one begins."""

import world
from bench import NODE, Bench

from mdms_protocol.codecs import cia402

TARGET = 100_000
RESET = (0x00, cia402.FAULT_RESET, cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)
UP = RESET[2:]


def cut(bench, ticks=1):
    """No later tick than this takes the voltage away, with no turn of the background in between."""
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
    """The wheels are ramped to rest within this many ticks, and stay there under all commands.

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


def run(row, board):
    bench = Bench(board)
    bench.boot()
    bench.drive(TARGET)
    assert not bench.off()
    world.sent.clear()
    row(bench)
    print("done")
