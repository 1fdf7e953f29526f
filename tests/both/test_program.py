"""A program on its way into its memory: what gets there, its check sum, and what is refused."""

import binascii

from mdms_cell.objects import Objects
from mdms_cell.program import Program
from mdms_protocol import sdo

DATA = 0x1F50
PIECES = (b"seven b", b"ytes in", b" all")


class Memory:
    """Keeps what it is told; `fails` names the call that does not work."""

    def __init__(self, fails=None):
        self.fails = fails
        self.told = []

    def begin(self, size):
        self._call("begin", size)

    def write(self, data):
        self._call("write", data)

    def end(self):
        self._call("end", None)

    def _call(self, name, argument):
        if name == self.fails:
            raise OSError(5)
        self.told.append((name, argument))


def bench(memory, driving=False):
    objects = Objects()
    Program(objects, memory, lambda: driving)
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


def test_check_sum_is_that_of_the_whole_program_and_only_when_it_is_whole():
    objects = bench(Memory())
    assert check_sum(objects) == 0
    download(objects)
    assert check_sum(objects) == binascii.crc32(b"".join(PIECES))
    sink = objects.open(DATA, 1, None)
    sink.write(b"another")
    assert check_sum(objects) == 0
    sink.cancel()
    assert check_sum(objects) == 0
    download(objects)
    assert check_sum(objects) == binascii.crc32(b"".join(PIECES))


def test_nothing_is_taken_while_a_motor_is_on():
    memory = Memory()
    assert download(bench(memory, driving=True)) == sdo.WRONG_STATE
    assert memory.told == []


def test_board_without_a_memory_refuses():
    assert download(bench(None)) == sdo.CANNOT_STORE


def test_memory_that_fails_at_any_call_is_told_and_leaves_no_program():
    for call in ("begin", "write", "end"):
        objects = bench(Memory(call))
        assert download(objects) == sdo.HARDWARE_ERROR
        assert check_sum(objects) == 0
