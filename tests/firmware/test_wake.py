"""A cell that is left alone until it is due does the same as one that looks after all every ms."""

from random import Random

from tests.both.bench import cell_bench

from mdms_cell import ticks
from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop as s
from mdms_cell.runner import BUS_OFF
from mdms_protocol.codecs import cob, nmt, sdo

NODE = 5
TIMES_MS = 3000
WRAP = 1 << 30


class Board(cell_bench.Board):
    """Two wheels that follow their voltage, or stand however hard they are driven."""

    def __init__(self):
        super().__init__()
        self.stuck = 0
        self.current_ma = 0

    def sample(self, registers):
        for axis in range(s.AXES):
            base = axis * s.AXIS
            if not self.stuck & 1 << axis:
                steps = registers[base + s.VOLTAGE] // 100_000
                registers[base + s.COUNT] = registers[base + s.COUNT] + steps & 0xFFFF
            registers[base + s.CURRENT] = self.current_ma


class Bench:
    """A cell on its board, polled every millisecond with everything to do, or when it is due."""

    def __init__(self, eager, start_ms):
        self.eager = eager
        self.board = Board()
        self.cell = Cell(self.board, NODE)
        self.now_ms = start_ms
        self.polls = 0
        self._bits = 0

    def hear(self, can_id, data):
        self.cell.now_ms = self.now_ms
        self.cell.on_frame(can_id, data, self.cell.now_ms)

    def pass_ms(self):
        """One tick and, if it is due, one poll; the sent frames, and the drive of the motors."""
        board, registers = self.board, self.board.registers
        self.now_ms = ticks.after(self.now_ms, 1)
        self.cell.tick()
        if self.eager:
            registers[s.ATTENTION] = 1
        late = ticks.diff(self.now_ms, self.cell.wake_ms) >= 0
        if late or registers[s.ATTENTION] or board.bits != self._bits:
            self.polls += 1
            self._bits = board.bits
            self.cell.poll(self.now_ms)
        return board.take(), registers[s.VOLTAGE], registers[s.AXIS + s.VOLTAGE]


def write(index, sub, *value):
    return cob.SDO_REQUEST_BASE + NODE, sdo.write_request(index, sub, bytes(value))


def words(word):
    return cob.RPDO_BASES[1] + NODE, bytes((word, 0, word, 0))


def speeds(first, second):
    data = (first & 0xFFFFFFFF).to_bytes(4, "little") + (second & 0xFFFFFFFF).to_bytes(4, "little")
    return cob.RPDO_BASES[0] + NODE, data


UP = (words(0x80), words(0x06), words(0x07), words(0x0F))
START = (cob.NMT, bytes((nmt.START, NODE)))
HALT = cob.RPDO_BASES[1] + NODE, b"\x0f\x01\x0f\x00"
#: Commands that change how a cell spends its time.
SELDOM = (
    START,
    words(0x00),
    words(0x02),
    words(0x06),
    HALT,
    (cob.NMT, bytes((nmt.STOP, NODE))),
    (cob.NMT, bytes((nmt.ENTER_PRE_OPERATIONAL, NODE))),
    (cob.NMT, bytes((nmt.RESET_COMMUNICATION, NODE))),
    (cob.HEARTBEAT_BASE + NODE, b"\x05"),
    (cob.HEARTBEAT_BASE + 0x7F, b"\x05"),
    (cob.HEARTBEAT_BASE + 0x7F, b"\x05"),
    write(0x1016, 1, 30, 0, 0x7F, 0),
    write(0x1016, 2, 70, 0, 0x7E, 0),
    (cob.HEARTBEAT_BASE + 0x7E, b"\x05"),
    write(0x1017, 0, 23, 0),
    write(0x1017, 0, 0, 0),
    write(0x1015, 0, 70, 0),
    write(0x1029, 1, 1),
    write(0x1400, 5, 25, 0),
    write(0x1401, 5, 120, 0),
    write(0x1801, 5, 33, 0),
    write(0x1801, 1, 0x85, 0x02, 0x00, 0x80),
    write(0x1801, 3, 95, 0),
    write(0x1801, 1, 0x85, 0x02, 0x00, 0x40),
    write(0x1801, 2, 0),
    write(0x1801, 2, 255),
    write(0x2004, 0, 0xF4, 0x01, 0, 0),
    write(0x2005, 0, 30, 0),
    write(0x2006, 0, 15, 0),
    write(0x200A, 0, 0, 0),
    write(0x606D, 0, 0x88, 0x13),
    write(0x606D, 0, 0x10, 0x00),
    write(0x606E, 0, 1, 0),
    write(0x686E, 0, 0, 0),
    write(0x60F8, 0, 0x50, 0xC3, 0, 0),
    write(0x2007, 0, 20, 0),
    (cob.SDO_REQUEST_BASE + NODE, sdo.read_request(0x1008, 0)),
    (cob.SDO_REQUEST_BASE + NODE, sdo.read_request(0x6041, 0)),
    (cob.SDO_REQUEST_BASE + NODE, b"\x60" + bytes(7)),
)


def happenings(chance):
    """The events at a bench in one millisecond."""
    if chance.randrange(10) == 0:
        yield lambda bench: bench.hear(cob.SYNC, b"")
    for axis_speeds in (speeds(60_000, -40_000), speeds(3_000, 0), speeds(0, 900_000)):
        if chance.randrange(40) == 0:
            yield lambda bench, frame=axis_speeds: bench.hear(*frame)
    if chance.randrange(30) == 0:
        frame = chance.choice(SELDOM)
        yield lambda bench: bench.hear(*frame)
    if chance.randrange(150) == 0:
        yield lambda bench: [bench.hear(*frame) for frame in (START, *UP)]
    if chance.randrange(50) == 0:
        bits = chance.randrange(32)
        yield lambda bench: setattr(bench.board, "bits", bits)
    if chance.randrange(100) == 0:
        stuck, current_ma = chance.randrange(4), chance.randrange(3) * 2000
        yield lambda bench: change(bench.board, stuck, current_ma)
    if chance.randrange(300) == 0:
        yield lambda bench: bench.cell.fail(BUS_OFF)
    if chance.randrange(300) == 0:
        yield lambda bench: bench.cell.recover()


def change(board, stuck, current_ma):
    board.stuck = stuck
    board.current_ma = current_ma


def lives(seed, start_ms=0):
    """Both benches through the same; all frames that were sent, and how often each was polled."""
    chance = Random(seed)
    lazy, eager = Bench(False, start_ms), Bench(True, start_ms)
    frames = []
    for time_ms in range(TIMES_MS):
        for happen in list(happenings(chance)):
            happen(lazy)
            happen(eager)
        said = lazy.pass_ms()
        assert said == eager.pass_ms(), (seed, time_ms)
        frames += said[0]
    return frames, lazy.polls, eager.polls


def test_polls_that_are_left_out_would_have_done_nothing():
    codes = set()
    for seed in range(12):
        frames, polls, all_polls = lives(seed)
        assert polls < all_polls
        codes |= {data[0] | data[1] << 8 for can_id, data in frames if can_id == 0x080 + NODE}
    assert codes == {0, 0x8130, 0x8140, 0x8150, 0x8250, 0x2310, 0x7121, 0x8611}, codes


def test_nothing_is_missed_across_the_wrap_of_the_clock():
    for seed in (101, 102):
        lives(seed, WRAP - TIMES_MS // 2)


def test_a_client_that_falls_silent_is_given_up_in_time():
    bench = Bench(False, 0)
    for _ in range(100):
        bench.pass_ms()
    bench.hear(*write(0x1017, 0, 0, 0))
    bench.pass_ms()
    bench.hear(cob.SDO_REQUEST_BASE + NODE, sdo.read_request(0x1008, 0))
    assert bench.pass_ms()[0][0][1][0] == sdo.UPLOAD_RESPONSE | sdo.SIZE_TOLD
    silent = [bench.pass_ms()[0] for _ in range(999)]
    told = cob.SDO_RESPONSE_BASE + NODE, sdo.abort(0x1008, 0, sdo.TIMED_OUT)
    assert [each for each in silent if each] == [[told]]
    assert silent[-1] == [told]


def test_a_cell_that_rolls_steadily_is_polled_for_its_heartbeat_only():
    bench = Bench(False, 0)
    for _ in range(100):
        bench.pass_ms()
    for frame in (START, *UP):
        bench.hear(*frame)
    for time_ms in range(2000):
        if time_ms == 1000:
            bench.polls = 0
        if time_ms % 10 == 0:
            bench.hear(*speeds(60_000, -40_000))
            bench.hear(cob.SYNC, b"")
        _, first_uv, second_uv = bench.pass_ms()
    assert first_uv
    assert second_uv
    assert bench.polls == 10
