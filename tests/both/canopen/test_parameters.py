"""0x1010 and 0x1011: the signature that a client must write, the saved groups, and the refusals."""

from cell_bench import NODE, Board, Memory, emergencies
from refusal import code_of

from mdms_cell.canopen.emcy import Emcy
from mdms_cell.canopen.objects import Objects, find
from mdms_cell.canopen.store import Parameters, Store, write_bank
from mdms_cell.cell import Cell
from mdms_protocol import record
from mdms_protocol.codecs import nmt, sdo

ALL = record.STORED_COMMUNICATION | record.STORED_APPLICATION
STORE = 0x1010
RESTORE = 0x1011
#: A setting of communication and one of the application, neither at its default.
CHANGED = ((0x1017, 333), (0x3000, 77))


class Bench:
    """A dictionary whose settings are not at their defaults, over a memory."""

    def __init__(self, memory=None):
        self.memory = memory or Memory()
        self.driving = False
        self.objects = Objects()
        self.objects.reset(5, ALL | record.FROM_NODE)
        store = Store(self.memory)
        self.sent = []
        self.emcy = Emcy(self.objects, self.send)
        self.parameters = Parameters(self.objects, store, lambda: self.driving, self.emcy)
        self.parameters.restore(ALL)

    def send(self, _can_id, data):
        self.sent.append(data)
        return True

    def emergencies(self):
        """The emergencies since the last call."""
        self.emcy.poll(0)
        sent, self.sent = self.sent, []
        return sent

    def change(self):
        for index, number in CHANGED:
            self.objects.put(index, 0, number)

    def write(self, index, sub, signature):
        """The code of the refusal, None if there was none."""
        return code_of(self.objects.write, find(index, sub), signature)

    def kept(self):
        """Which of the two settings a cell has that starts with this memory."""
        after = Bench(self.memory)
        return tuple(after.objects.number(index) == number for index, number in CHANGED)


def test_each_sub_index_saves_its_group():
    for sub, kept in ((1, (True, True)), (2, (True, False)), (3, (False, True))):
        bench = Bench()
        bench.change()
        assert bench.write(STORE, sub, b"save") is None
        assert bench.kept() == kept


def test_each_sub_index_restores_its_group_and_not_before_the_next_start():
    for sub, kept in ((1, (False, False)), (2, (False, True)), (3, (True, False))):
        bench = Bench()
        bench.change()
        bench.write(STORE, 1, b"save")
        assert bench.write(RESTORE, sub, b"load") is None
        assert bench.objects.number(0x1017) == 333
        assert bench.kept() == kept


def test_anything_but_the_signature_is_refused_and_changes_nothing():
    for index, wrong in (
        (STORE, b"load"),
        (STORE, b"evas"),
        (RESTORE, b"save"),
        (RESTORE, b"\1\0\0\0"),
    ):
        bench = Bench()
        bench.change()
        if index == RESTORE:
            bench.write(STORE, 1, b"save")
        before = bench.kept()
        assert bench.write(index, 1, wrong) == sdo.CANNOT_STORE
        assert bench.kept() == before


def test_nothing_is_saved_or_restored_while_a_motor_is_on():
    bench = Bench()
    bench.change()
    bench.driving = True
    for index, signature in ((STORE, b"save"), (RESTORE, b"load")):
        assert bench.write(index, 1, signature) == sdo.WRONG_STATE
    assert bench.kept() == (False, False)


def test_reading_tells_that_it_goes_on_command():
    bench = Bench()
    for index, signature in ((STORE, b"save"), (RESTORE, b"load"), (STORE, b"none")):
        bench.write(index, 1, signature)
        for sub in (1, 2, 3):
            assert bench.objects.read(index, sub) == b"\1\0\0\0"


def test_failing_memory_is_told():
    bench = Bench()
    bench.memory.broken = True
    assert bench.write(STORE, 1, b"save") == sdo.HARDWARE_ERROR
    assert bench.objects.read(STORE, 1) == b"\1\0\0\0"


#: As a bank has them: index, sub-index, type and size, and the bytes.
UNKNOWN = b"\xff\x2f\x01\x51\x07"
TOO_HIGH = b"\x00\x30\x00\x62\xff\xff"
TOLD = b"\x10\x63\x01\x08"
OVER = b"\x00\x00\x00\x08\0\0\0\0"


def with_misfits():
    """A memory with a value of no entry and a value that is out of its limits."""
    memory = Memory()
    write_bank(memory, 0, 1, UNKNOWN + TOO_HIGH)
    return memory


def test_saved_values_that_do_not_fit_are_reported_with_the_first_and_their_number():
    bench = Bench(with_misfits())
    assert bench.emergencies() == [TOLD + b"\xff\x2f\x01\x02"]
    assert bench.objects.number(0x3000) == 50
    bench.parameters.restore(record.STORED_COMMUNICATION)
    assert bench.emergencies() == []


def test_report_of_misfits_ends_when_they_are_given_up():
    for index, signature in ((STORE, b"save"), (RESTORE, b"load")):
        bench = Bench(with_misfits())
        bench.emergencies()
        # The one of no entry goes with any group, the other with its own.
        assert bench.write(index, 2, signature) is None
        assert bench.emergencies() == []
        assert bench.write(index, 3, signature) is None
        assert bench.emergencies() == [OVER]
        assert Bench(bench.memory).emergencies() == []


def test_settings_that_fit_are_not_reported():
    bench = Bench()
    bench.change()
    bench.write(STORE, 1, b"save")
    assert Bench(bench.memory).emergencies() == []


def test_cell_with_a_saved_pdo_of_an_object_that_is_gone_boots_and_reports_it():
    board = Board()
    board.settings = Memory()
    write_bank(board.settings, 0, 1, b"\x00\x1a\x01\x74\x20\x00\xff\x2f" + UNKNOWN)
    cell = Cell(board, NODE)
    cell.poll(0)
    cell.poll(50)
    cell.poll(51)
    assert cell.state == nmt.PRE_OPERATIONAL
    assert emergencies(board) == [TOLD + b"\xff\x2f\x01\x02"]
    cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
    cell.on_frame(0x080, b"", cell.now_ms)
    assert (0x185, bytes(8)) in board.take()
