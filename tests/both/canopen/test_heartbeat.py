"""The heartbeat producer by itself: when it sends, and when it says that it will send again."""

from mdms_cell import ticks
from mdms_cell.canopen.nmt import Heartbeat
from mdms_cell.canopen.objects import Objects, find
from mdms_protocol.codecs import nmt

PERIOD = 0x1017
NODE = 5
WRAP = 1 << 30


class Bench:
    """A heartbeat that began at some instant; time is told as milliseconds since."""

    def __init__(self, period_ms, start_ms=0):
        self.objects = Objects()
        self.objects.put(PERIOD, 0, period_ms)
        self.start_ms = start_ms
        self.sent = []
        self.room = True
        self.heartbeat = Heartbeat(self.objects, self.send)
        self.heartbeat.start(start_ms)

    def send(self, can_id, data):
        if self.room:
            self.sent.append((can_id, data))
        return self.room

    def poll(self, elapsed_ms, state=nmt.PRE_OPERATIONAL):
        """The number of sent frames, and the milliseconds until the next wanted poll."""
        self.sent.clear()
        wait_ms = self.heartbeat.poll(ticks.after(self.start_ms, elapsed_ms), NODE, state)
        return len(self.sent), wait_ms


def test_tells_the_state_once_a_period():
    bench = Bench(100)
    assert bench.poll(99) == (0, 1)
    assert bench.poll(100, nmt.OPERATIONAL) == (1, 100)
    assert bench.sent == [(0x705, b"\x05")]
    assert bench.poll(100) == (0, 100)
    assert bench.poll(200, nmt.STOPPED) == (1, 100)
    assert bench.sent == [(0x705, b"\x04")]


def test_one_that_is_late_does_not_delay_those_after_it():
    bench = Bench(100)
    assert bench.poll(130) == (1, 70)
    assert bench.poll(199) == (0, 1)
    assert bench.poll(200) == (1, 100)


def test_those_that_were_missed_altogether_are_not_made_up_for():
    bench = Bench(100)
    assert bench.poll(450) == (1, 100)
    assert bench.poll(549) == (0, 1)
    assert bench.poll(550) == (1, 100)
    # Late by exactly a period: the heartbeat due now has been missed, too.
    assert bench.poll(750) == (1, 100)
    assert bench.poll(750) == (0, 100)


def test_grid_holds_over_the_wrap_of_the_clock():
    bench = Bench(7, WRAP - 50)
    times = [elapsed_ms for elapsed_ms in range(1, 120) if bench.poll(elapsed_ms)[0]]
    assert times == list(range(7, 120, 7))


def test_period_of_0_is_never():
    bench = Bench(0)
    for elapsed_ms in (0, 1, 65_535, 1 << 28):
        assert bench.poll(elapsed_ms) == (0, ticks.IDLE_MS)


def test_another_period_begins_when_it_is_written():
    bench = Bench(100)
    bench.poll(30)
    bench.objects.write(find(PERIOD, 0), b"\x14\x00")
    assert bench.poll(49) == (0, 1)
    assert bench.poll(50) == (1, 20)


def test_full_queue_costs_one_heartbeat_and_not_the_grid():
    bench = Bench(100)
    bench.room = False
    assert bench.poll(100) == (0, 100)
    bench.room = True
    assert bench.poll(200) == (1, 100)


def test_answer_is_one_more_heartbeat_as_soon_as_there_is_room():
    for period_ms in (0, 100):
        bench = Bench(period_ms)
        bench.heartbeat.answer()
        bench.room = False
        assert bench.poll(1) == (0, ticks.RETRY_MS)
        bench.room = True
        assert bench.poll(2)[0] == 1
        assert bench.poll(3)[0] == 0
        assert bench.poll(100)[0] == (1 if period_ms else 0)
