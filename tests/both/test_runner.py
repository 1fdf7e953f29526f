"""The turns of the background loop: the calls of the board, and the feeding of its watchdog."""

from cell_bench import Board as CellBoard

from mdms_cell.drive import speed_loop
from mdms_cell.mailboxes import STAMP, Mailboxes
from mdms_cell.queues import Inbox
from mdms_cell.runner import BUS_OFF, Runner

BOXED = 0x186
TAKEN = (0x000, 0x080, 0x205, 0x605)
REMOTE = 1
EXTENDED = 2


class Board(CellBoard):
    """A board with all methods that a runner calls; it records its calls."""

    def __init__(self):
        super().__init__()
        self.inbox = Inbox(registers=self.registers)
        self.bus_off = False
        self.fed = 0
        self.cut = 0
        self.shown = None
        self.serviced_ms = None
        self._frames = []

    def service(self, now_ms):
        self.serviced_ms = now_ms

    def show(self, now_ms, state, faulty):
        self.shown = (now_ms, state, faulty)

    def feed(self):
        self.fed += 1

    def motors_off(self):
        self.cut += 1

    def receive(self, *frames):
        self._frames.extend(frames)
        while self._frames:
            self.inbox.take(self)

    def recv(self, into):
        if not self._frames:
            return None
        into[0], data, into[2] = self._frames.pop(0)
        into[1] = memoryview(data)
        return into


class Cell:
    """Records its calls; its tick counts, and raises `error` if there is one.

    It takes what these tests send, and has a box for frames with the identifier `BOXED`.
    """

    def __init__(self, registers):
        self.registers = registers
        self.state = 5
        self.told = []
        self.error = None
        self.received = 0
        self.waited_ms = None
        self.mailboxes = Mailboxes(1, 0)
        accepts = dict.fromkeys(TAKEN)
        accepts[BOXED] = 0
        self.mailboxes.listen(accepts)

    def tick(self):
        if self.error is not None:
            raise self.error
        self.registers[speed_loop.TICKS] += 1

    def on_frame(self, can_id, data, now_ms):
        self.now_ms = now_ms
        self.told.append((can_id, bytes(data)))

    def poll(self, now_ms):
        self.told.append(("poll", now_ms))

    def fail(self, error_code):
        self.told.append(("fail", error_code))

    def recover(self):
        self.told.append(("recover",))


def bench():
    board = Board()
    cell = Cell(board.registers)
    return Runner(board, cell), cell, board


def test_turn_takes_all_frames_in_their_order_and_then_polls():
    runner, cell, board = bench()
    board.receive((0x080, b"", 0), (0x205, b"12345678", 0), (0x605, b"abc", 0))
    runner.turn(77)
    assert cell.told == [(0x080, b""), (0x205, b"12345678"), (0x605, b"abc"), ("poll", 77)]
    assert cell.now_ms == 77
    assert board.serviced_ms == 77
    runner.turn(78)
    assert cell.told[4:] == [("poll", 78)]


def test_remote_and_extended_frames_do_not_reach_the_cell():
    runner, cell, board = bench()
    board.receive((0x000, b"\x01\x05", REMOTE), (0x000, b"\x81\x05", EXTENDED), (0x080, b"", 0))
    runner.turn(0)
    assert cell.told == [(0x080, b""), ("poll", 0)]


def test_watchdog_is_fed_once_a_turn_while_the_tick_is_alive():
    runner, _, board = bench()
    runner.turn(0)
    fed = board.fed
    runner.turn(1)
    assert board.fed == fed
    runner.tick()
    runner.tick()
    runner.turn(2)
    runner.turn(3)
    assert board.fed == fed + 1


def test_error_in_the_tick_cuts_the_motors_for_good_and_is_raised_by_the_turn():
    runner, cell, board = bench()
    cell.error = ValueError("encoder")
    runner.tick()
    assert board.cut == 1
    assert board.registers[speed_loop.CUT] == 1
    cell.error = None
    runner.tick()
    assert board.cut == 2
    assert board.registers[speed_loop.TICKS] == 0
    try:
        runner.turn(0)
    except ValueError:
        assert cell.told == []
        assert board.fed == 0
        return
    raise AssertionError("the background was not told")


def test_bus_off_is_a_failure_until_the_bus_is_back():
    runner, cell, board = bench()
    board.bus_off = True
    # As the interrupt does.
    board.registers[speed_loop.CUT] = 1
    runner.turn(0)
    runner.turn(1)
    assert cell.told == [("fail", BUS_OFF), ("poll", 0), ("poll", 1)]
    assert board.registers[speed_loop.CUT] == 1
    board.bus_off = False
    runner.turn(2)
    runner.turn(3)
    assert cell.told[3:] == [("recover",), ("poll", 2), ("poll", 3)]
    assert board.registers[speed_loop.CUT] == 0


def test_fault_of_either_axis_is_shown():
    for place in (speed_loop.FAULTS, speed_loop.AXIS + speed_loop.FAULTS):
        runner, _, board = bench()
        runner.turn(5)
        assert board.shown == (5, 5, False)
        board.registers[place] = speed_loop.STALE
        runner.turn(6)
        assert board.shown == (6, 5, True)


def test_a_turn_takes_no_more_frames_than_it_may_and_the_next_one_goes_on():
    runner, cell, board = bench()
    board.receive(*[(0x080, bytes((number,)), 0) for number in range(40)])
    for turn in range(3):
        runner.turn(turn)
    polls = [place for place, what in enumerate(cell.told) if what[0] == "poll"]
    assert polls == [16, 33, 42]
    assert [what[1][0] for what in cell.told if what[0] == 0x080] == list(range(40))


def test_cell_is_told_how_long_a_frame_has_waited():
    runner, cell, board = bench()
    take = cell.on_frame

    def note(can_id, data, now_ms):
        take(can_id, cell.waited_ms.to_bytes(1, "little"), now_ms)

    cell.on_frame = note
    for tick in (250, 258):
        board.registers[speed_loop.TICKS] = tick
        board.receive((0x080, b"", 0))
    board.registers[speed_loop.TICKS] = 261
    runner.turn(0)
    assert cell.told == [(0x080, b"\x0b"), (0x080, b"\x03"), ("poll", 0)]
    assert cell.waited_ms == 0


def test_frame_that_has_a_box_waits_there_and_the_others_keep_their_order():
    runner, cell, board = bench()
    board.receive((BOXED, b"abcdefgh", 0), (0x080, b"", 0), (BOXED, b"12345678", 0))
    board.receive((0x205, b"", 0))
    runner.turn(0)
    assert cell.told == [(0x080, b""), (0x205, b""), ("poll", 0)]
    assert cell.mailboxes.frames == b"12345678"
    assert cell.mailboxes.fresh == b"\x01"
    assert cell.received == 2


def test_frame_is_stamped_with_the_values_of_its_turn():
    runner, cell, board = bench()
    take = cell.on_frame

    def beat(can_id, data, now_ms):
        cell.mailboxes.counts[STAMP] += 1
        take(can_id, data, now_ms)

    cell.on_frame = beat
    board.receive((0x080, b"", 0), (BOXED, b"12345678", 0), (0x080, b"", 0))
    runner.turn(0)
    assert cell.mailboxes.counts[STAMP] == 2
    assert cell.mailboxes.stamps[0] == 1


def test_frame_of_another_length_goes_to_the_cell_and_finds_its_box_closed():
    runner, cell, board = bench()
    board.receive((BOXED, b"1234567", 0), (BOXED, b"12345678", REMOTE))
    runner.turn(0)
    assert cell.told == [(BOXED, b"1234567"), ("poll", 0)]
    assert not cell.mailboxes.put(0, b"1234567")
    assert cell.mailboxes.fresh == b"\x00"


def test_frames_that_the_cell_does_not_take_are_dropped_unseen_round_and_round():
    runner, cell, board = bench()
    for turn in range(20):
        board.receive(*[(0x1F0 + number, b"12345678", 0) for number in range(8)])
        board.receive((0x080, bytes((turn,)), 0))
        runner.turn(turn)
    assert [what[1] for what in cell.told if what[0] == 0x080] == [bytes((n,)) for n in range(20)]
    assert len(cell.told) == 40
    assert board.inbox.peek() is None


def test_box_that_no_longer_serves_its_identifier_takes_no_frame():
    runner, cell, board = bench()
    cell.mailboxes.listen({BOXED: None})
    board.receive((BOXED, b"12345678", 0))
    runner.turn(0)
    assert cell.told == [(BOXED, b"12345678"), ("poll", 0)]
    assert cell.received == 0
