"""The common beat: cells on a wire of whole milliseconds, on every interpreter."""

from cell_bench import booted

from mdms_cell import ticks
from mdms_cell.canopen.pdos import Beat
from mdms_protocol.codecs import sdo

PERIOD_MS = 10


class Line:
    """Beats that see each other's SYNC within the millisecond, unless cut off; ranks from 0."""

    def __init__(self, count, now_ms=0):
        self.now_ms = now_ms
        self.beats = [self.fresh(rank) for rank in range(count)]
        self.parts = [0] * count
        self.sent = []

    def fresh(self, rank):
        beat = Beat()
        beat.configure(1, rank, PERIOD_MS, self.now_ms)
        beat.start(self.now_ms)
        return beat

    def turn(self, ms, crossing=False, host_every=0):
        """So many milliseconds; `crossing`: all poll before any sees the frames of the others."""
        for _ in range(ms):
            self.now_ms = ticks.after(self.now_ms, 1)
            if host_every and self.now_ms % host_every == 0:
                self.show("host", 0)
            late = []
            for rank, beat in enumerate(self.beats):
                if beat is not None and beat.poll(self.now_ms):
                    late.append(rank)
                    if not crossing:
                        self.show(late.pop(), self.parts[rank])
            for rank in late:
                self.show(rank, self.parts[rank])

    def show(self, sender, part):
        self.sent.append((self.now_ms, sender))
        for rank, beat in enumerate(self.beats):
            if beat is not None and rank != sender and self.parts[rank] == part:
                beat.on_sync(self.now_ms)

    def senders(self, since_ms):
        return [sender for now_ms, sender in self.sent if now_ms > since_ms]

    def gaps(self):
        times = [now_ms for now_ms, _ in self.sent]
        return [ticks.diff(times[at + 1], times[at]) for at in range(len(times) - 1)]


def test_first_in_rank_takes_over_and_keeps_the_period():
    line = Line(18)
    line.turn(300)
    assert set(line.senders(0)) == {0}
    assert line.sent[0][0] == 25
    assert set(line.gaps()) == {PERIOD_MS}


def test_loss_of_the_producer_is_made_up_for_within_three_beats():
    line = Line(18)
    line.turn(100)
    line.beats[0] = None
    line.turn(200)
    assert set(line.senders(100)) == {1}
    assert max(line.gaps()) <= 3 * PERIOD_MS


def test_gap_stays_below_the_setpoint_timeout_when_all_but_the_last_are_gone():
    line = Line(22)
    line.turn(100)
    for rank in range(21):
        line.beats[rank] = None
    line.turn(200)
    assert set(line.senders(100)) == {21}
    assert max(line.gaps()) < 50


def test_successor_that_crashes_at_once_is_followed_by_the_next():
    line = Line(18)
    line.turn(100)
    line.beats[0] = None
    line.turn(27)
    assert line.senders(100) == [1]
    line.beats[1] = None
    line.turn(100)
    assert set(line.senders(127)) == {2}
    assert max(line.gaps()) <= 3 * PERIOD_MS


def test_producer_that_comes_back_follows():
    line = Line(18)
    line.turn(100)
    line.beats[0] = None
    line.turn(60)
    line.beats[0] = line.fresh(0)
    line.turn(300)
    assert set(line.senders(160)) == {1}


def test_two_beats_coexist_for_one_beat_at_most_after_a_partition():
    for apart_ms in range(100, 120):
        line = Line(18)
        line.turn(100)
        line.parts = [0] * 9 + [1] * 9
        line.turn(apart_ms)
        assert set(line.senders(100)) == {0, 9}
        healed_ms = line.now_ms
        line.parts = [0] * 18
        line.turn(200)
        assert len(set(line.senders(healed_ms + PERIOD_MS))) == 1


def test_two_whose_beats_cross_yield_and_the_lower_rank_returns():
    line = Line(18)
    line.turn(100)
    line.parts = [0] * 9 + [1] * 9
    line.turn(105)
    # Both send in the same millisecond from here on, and neither sees it before.
    line.beats[0]._due_ms = line.beats[9]._due_ms = ticks.after(line.now_ms, 3)
    line.parts = [0] * 18
    line.turn(3, crossing=True)
    assert not any(beat.producing for beat in line.beats)
    crossed_ms = line.now_ms
    line.turn(200)
    assert set(line.senders(crossed_ms)) == {0}
    assert line.sent[-1][0] - crossed_ms > 150
    after = [gap for gap in line.gaps() if gap > PERIOD_MS]
    assert max(after) < 30


def test_cells_yield_to_the_host_and_take_over_when_it_is_gone():
    line = Line(18)
    line.turn(104)
    line.turn(300, host_every=10)
    assert set(line.senders(110)) == {"host"}
    gone_ms = line.now_ms
    line.turn(100)
    assert set(line.senders(gone_ms)) == {0}
    assert max(line.gaps()) <= 3 * PERIOD_MS


def test_beat_goes_on_where_the_clock_wraps():
    line = Line(3, (1 << 30) - 60)
    line.turn(200)
    assert set(line.gaps()) == {PERIOD_MS}
    assert {sender for _, sender in line.sent} == {0}


def syncs(board):
    return [frame for frame in board.take() if frame[0] == 0x080]


def turn(cell, ms):
    for _ in range(ms):
        cell.poll(ticks.after(cell.now_ms, 1))


def test_cell_gives_the_beat_only_where_it_is_enabled_and_operational():
    cell, board = booted()
    cell.on_frame(0x605, sdo.write_request(0x3014, 3, b"\x01"), cell.now_ms)
    turn(cell, 100)
    assert syncs(board) == []
    cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
    turn(cell, 29)
    board.take()
    turn(cell, 10)
    # Its own speeds go with its own beat.
    assert [can_id for can_id, _ in board.take()] == [0x080, 0x185]
    cell.on_frame(0x605, sdo.write_request(0x3014, 3, b"\x00"), cell.now_ms)
    turn(cell, 100)
    assert syncs(board) == []


def test_cell_is_silent_while_somebody_else_gives_the_beat():
    cell, board = booted()
    cell.on_frame(0x605, sdo.write_request(0x3014, 3, b"\x01"), cell.now_ms)
    cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
    for _ in range(10):
        turn(cell, 10)
        cell.on_frame(0x080, b"", cell.now_ms)
    assert syncs(board) == []


def test_rank_may_be_set_apart_from_the_node_id():
    cell, board = booted()
    cell.on_frame(0x605, sdo.write_request(0x3014, 3, b"\x01"), cell.now_ms)
    cell.on_frame(0x605, sdo.write_request(0x3014, 4, b"\x01"), cell.now_ms)
    cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
    turn(cell, 24)
    assert syncs(board) == []
    turn(cell, 1)
    assert len(syncs(board)) == 1
