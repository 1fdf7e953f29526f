"""Rows of the fail-safe table about the program, from its start to its end; on MicroPython."""

import os

import world
from bench import NODE
from fail_safe_bench import RESET, TARGET, UP, comes_back, cut, emergencies, keep

from boards import start
from mdms_cell.drive import speed_loop as s
from mdms_protocol.version import VERSION

#: For so long the processor of a PYBv1.1 may stand when a file is closed.
SECTOR_ERASE_MS = 2000


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

    def log_slowly(error, folder):
        assert world.levels[bench.wake]
        patience_ms = [each[1] for each in world.told if each[0] == "watchdog"][-1]
        assert world.now_ms + SECTOR_ERASE_MS - world.fed_ms < patience_ms
        # A cell that fails at every start writes that once.
        for _ in range(2):
            log(error, folder)
        # The supply may have failed while the log was written.
        os.mkdir("garbled")
        with open("garbled/crash.log", "wb") as file:
            file.write(b"\xc3" * 4000)
        log(error, "garbled")
        assert os.stat("garbled/crash.log")[6] > 4000

    world.events[start_ms + 50] = plan
    log, start.log = start.log, log_slowly
    try:
        start.run(bench.board, None, ".", NODE)
    except wanted:
        world.told.append("ended")
    assert world.told[-1] == "ended"
    awake_ms = bench.board.WATCHDOG_MS
    assert ("watchdog", awake_ms) == [each for each in world.told if each[0] == "watchdog"][-1]
    assert bench.off()
    assert 0x6100 in emergencies()
    with open("crash.log") as file:
        text = file.read()
    assert text.startswith("mdms " + VERSION + "\nTraceback")
    assert wanted.__name__ in text
    assert text.count("Traceback") == 1


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
