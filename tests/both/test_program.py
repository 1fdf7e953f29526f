"""A program on its way into its memory: what gets there, what is refused, and what has to wait."""

import binascii

from cell_bench import NODE, Board, enable

from mdms_cell.cell import Cell
from mdms_cell.objects import Objects
from mdms_cell.program import Program
from mdms_protocol import cia402, pdo, sdo

DATA = 0x1F50
PIECES = (b"seven b", b"ytes in", b" all")


class Memory:
    """Keeps what it is told; `fails` names the call that does not work."""

    def __init__(self, fails=None, crc=0):
        self.fails = fails
        self.crc = crc
        self.told = []

    def begin(self, size):
        self._call("begin", size)

    def write(self, data):
        self._call("write", data)

    def end(self):
        self._call("end", None)
        self.crc = binascii.crc32(b"".join(PIECES))

    def cancel(self):
        self._call("cancel", None)

    def _call(self, name, argument):
        if name == self.fails:
            raise OSError(5)
        self.told.append((name, argument))


class Axes:
    """Which motors are on, and what they wait for."""

    def __init__(self, driving):
        self._driving = driving

    def driving(self):
        return self._driving

    def hold(self, holds):
        self.holds = holds


class Emcy:
    """Errors by their source."""

    def __init__(self):
        self.errors = {}

    def report(self, source, code):
        self.errors[source] = code

    def clear(self, source):
        self.errors.pop(source, None)


def bench(memory, driving=False):
    objects = Objects()
    Program(objects, memory, Axes(driving), Emcy())
    return objects


def check_sum(objects):
    return int.from_bytes(objects.read(0x1F56, 1), "little")


def download(objects, size=None):
    """The code of the refusal, None if there was none."""
    try:
        sink = objects.open(DATA, 1, size)
        for piece in PIECES:
            sink.write(piece)
        sink.finish()
    except sdo.AbortError as refusal:
        return refusal.code
    return None


def test_pieces_get_into_the_memory_in_their_order():
    for size in (None, 18):
        memory = Memory()
        assert download(bench(memory), size) is None
        written = [("write", piece) for piece in PIECES]
        assert memory.told[0] == ("begin", size)
        assert memory.told[1:-1] == written
        assert memory.told[-1] == ("end", None)


def test_check_sum_is_that_of_the_program_in_the_memory():
    objects = bench(Memory(crc=0x12345678))
    assert check_sum(objects) == 0x12345678
    sink = objects.open(DATA, 1, None)
    sink.write(b"another")
    assert check_sum(objects) == 0x12345678
    sink.cancel()
    assert check_sum(objects) == 0x12345678
    download(objects)
    assert check_sum(objects) == binascii.crc32(b"".join(PIECES))


def test_nothing_is_taken_while_a_motor_is_on():
    memory = Memory()
    assert download(bench(memory, driving=True)) == sdo.WRONG_STATE
    assert memory.told == []


def test_board_without_a_memory_refuses():
    objects = bench(None)
    assert download(objects) == sdo.CANNOT_STORE
    assert check_sum(objects) == 0


def test_memory_that_fails_at_any_call_is_told_and_leaves_no_program():
    for call in ("begin", "write", "end"):
        memory = Memory(call)
        objects = bench(memory)
        assert download(objects) == sdo.HARDWARE_ERROR
        assert check_sum(objects) == 0
        assert memory.told[-1] == ("cancel", None)


BEGIN = b"\x21\x50\x1f\x01\x12\0\0\0"
SEGMENTS = (b"\x00seven b", b"\x10ytes in", b"\x07 all\0\0\0")
ABORT = b"\x80\x50\x1f\x01\0\0\0\x08"
BUSY = b"\x20\x55\x01\x07\0\0\0\0"
NO_ERROR = b"\0\0\0\x07\0\0\0\0"


class Bench:
    """An operational cell with a memory for a program, its motors off."""

    def __init__(self, memory):
        self.board = Board()
        self.board.program = memory
        self.cell = Cell(self.board, NODE)
        self.now_ms = -50
        self.pass_ms(50)
        self.pass_ms(50)
        self.send(0x000, b"\x01\x00")

    def pass_ms(self, ms=1):
        self.now_ms += ms
        self.cell.poll(self.now_ms)

    def send(self, can_id, *frames):
        for data in frames:
            self.cell.on_frame(can_id, data)
            self.pass_ms()

    def ask(self, *requests):
        self.send(0x600 + NODE, *requests)

    def states(self):
        """What the axes say, who are asked to drive."""
        enable(self.cell)
        self.pass_ms()
        told = [data for can_id, data in self.board.sent if can_id == 0x280 + NODE]
        return [word & 0x6F for word in pdo.STATUS.decode(told[-1])[:2]]

    def emergencies(self):
        return [data for can_id, data in self.board.take() if can_id == 0x080 + NODE]


ON = [cia402.OPERATION_ENABLED] * 2
WAITING = [cia402.SWITCHED_ON] * 2


def test_axes_wait_while_a_program_comes_and_say_why():
    memory = Memory()
    bench = Bench(memory)
    bench.ask(BEGIN, SEGMENTS[0])
    assert bench.states() == WAITING
    assert bench.states() == WAITING
    assert bench.emergencies() == [BUSY]
    bench.ask(*SEGMENTS[1:])
    assert memory.told[-1] == ("end", None)
    bench.pass_ms()
    assert bench.emergencies() == [NO_ERROR]
    assert bench.states() == ON


def test_axis_that_is_on_has_a_program_refused_and_stays_on():
    memory = Memory()
    bench = Bench(memory)
    assert bench.states() == ON
    bench.board.take()
    bench.ask(BEGIN)
    abort = sdo.abort(DATA, 1, sdo.WRONG_STATE)
    assert (0x580 + NODE, abort) in bench.board.sent
    assert memory.told == []


def test_program_that_is_given_up_is_dropped_at_once_and_axes_may_be_enabled():
    for give_up in (
        lambda bench: bench.ask(ABORT),
        lambda bench: bench.pass_ms(1000),
        lambda bench: bench.ask(b"\x40\x00\x10\0\0\0\0\0"),
        lambda bench: bench.send(0x000, b"\x02\x05", b"\x01\x05"),
        lambda bench: bench.send(0x000, b"\x80\x05", b"\x01\x05"),
        lambda bench: bench.send(0x600 + NODE, b"\x00seven b"),
    ):
        memory = Memory()
        bench = Bench(memory)
        bench.ask(BEGIN, SEGMENTS[0])
        assert memory.told[-1] == ("write", PIECES[0])
        give_up(bench)
        assert memory.told[-1] == ("cancel", None)
        assert bench.states() == ON


def test_reset_of_the_node_drops_a_program_at_once():
    for command in (0x81, 0x82):
        memory = Memory()
        bench = Bench(memory)
        bench.ask(BEGIN, SEGMENTS[0])
        bench.cell.on_frame(0x000, bytes((command, NODE)))
        assert memory.told[-1] == ("cancel", None)


def test_axes_stay_off_when_a_program_cannot_be_dropped():
    memory = Memory("cancel")
    bench = Bench(memory)
    bench.ask(BEGIN, SEGMENTS[0], ABORT)
    assert bench.states() == WAITING
    memory.fails = None
    bench.ask(BEGIN, *SEGMENTS)
    assert bench.states() == ON


def test_program_of_four_bytes_that_fails_leaves_nothing_to_wait_for():
    for call in ("begin", "write", "end"):
        memory = Memory(call)
        bench = Bench(memory)
        bench.ask(b"\x23\x50\x1f\x01abcd")
        assert memory.told[-1] == ("cancel", None)
        assert bench.states() == ON
