"""A cell whose updates take long, as interrupts and background of a slow board come to it."""

from layer_bench import BEAT_MS, IDENTITY, NODE, Middle, estimate_of, estimates, some_of
from layer_bench import run as layer_run

from mdms_cell.drive import speed_loop
from mdms_cell.queues import Inbox
from mdms_cell.runner import Runner
from mdms_protocol import indices
from mdms_protocol.codecs import cob, sdo
from mdms_protocol.neighbours import frames as wire

SPEED_UM_S = 60_000
SETPOINT_TIMEOUT_MS = 50
#: Frames of neighbours that come within a millisecond.
_FRAMES_PER_MS = 4
_SDO_REQUEST = cob.SDO_REQUEST_BASE + NODE


class Bus:
    """Takes the frames that `Middle` makes, for the controller to receive later."""

    def __init__(self, registers):
        self.frames = []
        self._registers = registers

    def on_frame(self, can_id, data, _now_ms):
        self.frames.append((can_id, data))

    def poll(self, _now_ms):
        """Nothing: time passes in the machine."""


class Machine:
    """The cell; each update keeps its processor busy for `update_ms`, with interrupts going on.

    The speed loop does not run: a tick only counts.
    """

    def __init__(self, update_ms):
        self.middle = Middle(SPEED_UM_S)
        self.update_ms = update_ms
        self.cell, self.board = self.middle.cell, self.middle.board
        self.middle.cell = self._bus = Bus(self.board.registers)
        self.board.inbox = Inbox(registers=self.board.registers)
        self.board.bus_off = False
        self.board.service = self.board.feed = self.board.show = self._nothing
        self._runner = Runner(self.board, self.cell)
        self._now_ms = self._busy_until_ms = self.middle.now_ms
        self._received = None
        #: Beats in which the wheels were fed, the greatest age of a setpoint [ms], the sent frames.
        self.fed = []
        self.oldest_ms = 0
        self.sent = []
        self.beats = 0

    def _nothing(self, *_arguments):
        pass

    def recv(self, into):
        into[0], into[1] = self._received
        into[2] = into[3] = 0
        return into

    def _receive(self, can_id, data):
        self._received = can_id, memoryview(bytearray(data))
        self.board.inbox.take(self)

    def pause(self, pause_ms):
        """The background stands, as while garbage is collected."""
        self._busy_until_ms = max(self._busy_until_ms, self._now_ms) + pause_ms

    def beat(self, pause_at_ms=None, pause_ms=0):
        """Ten milliseconds from SYNC on; the sent frames, with the parcel's place at that SYNC."""
        sent_from_um = self.middle.x_um
        self.middle.beat()
        frames, self._bus.frames = self._bus.frames, []
        self._receive(*frames.pop(0))
        self._receive(_SDO_REQUEST, sdo.read_request(indices.IDENTITY, 1))
        for time_ms in range(BEAT_MS):
            if time_ms:
                for _ in range(min(_FRAMES_PER_MS, len(frames))):
                    self._receive(*frames.pop(0))
            if time_ms == pause_at_ms:
                self.pause(pause_ms)
            self._pass_ms()
        self.beats += 1
        for can_id, data in self.board.take():
            self.sent.append((self.beats, can_id, data, sent_from_um))

    def _pass_ms(self):
        registers = self.board.registers
        registers[speed_loop.TICKS] += 1
        registers[speed_loop.AGE] += 1
        self.oldest_ms = max(self.oldest_ms, registers[speed_loop.AGE])
        if self._now_ms >= self._busy_until_ms:
            self._runner.turn(self._now_ms)
            if registers[speed_loop.AGE] == 0:
                self.fed.append(self.beats)
                self._busy_until_ms = self._now_ms + self.update_ms
        self._now_ms += 1

    def gaps(self):
        """Beats from one feeding of the wheels to the next."""
        return [later - earlier for earlier, later in zip(self.fed, self.fed[1:])]  # noqa: B905

    def estimates(self):
        """Of each the beat, its fields, and where along x the parcel was at the SYNC of that."""
        for beat, can_id, data, x_um in self.sent:
            if can_id == cob.TPDO_BASES[2] + NODE:
                yield beat, estimate_of(data), x_um


def run(update_ms, beats=90):
    machine = Machine(update_ms)
    for _ in range(30):
        machine.beat()
    machine.fed, machine.sent, machine.oldest_ms, machine.beats = [], [], 0, 0
    for _ in range(beats):
        machine.beat()
    return machine


def check_goes_on(machine):
    """The parcel is driven on: nobody holds it, and all are told where it is at each SYNC.

    Requests are answered between updates.
    """
    told = [can_id for _, can_id, _, _ in machine.sent]
    for can_id in (cob.TPDO_BASES[2] + NODE, cob.SDO_RESPONSE_BASE + NODE):
        assert told.count(can_id) >= machine.beats - 2
    for _, fields, x_um in machine.estimates():
        assert fields[wire.IDENTITY] == IDENTITY
        assert fields[wire.HOLD] == wire.HOLD_NONE
        assert abs(fields[wire.X] * wire.STEP_UM - x_um) < 3_000, (fields[wire.X] * 250, x_um)
    assert machine.oldest_ms < SETPOINT_TIMEOUT_MS
    registers = machine.board.registers
    assert registers[speed_loop.TARGET] > 80_000


def test_update_that_leaves_the_next_sync_its_time_takes_place_in_each_beat():
    for update_ms in some_of((1, 3, 4, 5)):
        machine = run(update_ms)
        assert set(machine.gaps()) == {1}
        check_goes_on(machine)


def test_update_of_a_beat_and_more_takes_place_in_every_second_beat():
    for update_ms in some_of((6, 9, 10, 11, 14)):
        machine = run(update_ms)
        assert set(machine.gaps()) == {2}, (update_ms, machine.gaps())
        check_goes_on(machine)


def test_update_of_two_beats_takes_place_in_every_third():
    for update_ms in some_of((16, 20, 24)):
        machine = run(update_ms)
        assert set(machine.gaps()) == {3}, (update_ms, machine.gaps())
        check_goes_on(machine)


def test_estimates_have_the_place_at_each_sync_whether_updates_were_skipped_or_not():
    step_um = SPEED_UM_S * BEAT_MS // 1000
    for update_ms in (3, 9, 20):
        places = [fields[wire.X] for _, fields, _ in run(update_ms, beats=30).estimates()]
        steps = [places[place + 1] - places[place] for place in range(len(places) - 1)]
        assert set(steps) == {step_um // wire.STEP_UM, step_um // wire.STEP_UM + 1}, places


def test_update_after_any_number_of_skipped_beats_sends_an_estimate_again():
    for skipped in (1, 10, 60):
        middle = Middle(SPEED_UM_S)
        for _ in range(skipped):
            middle.now_ms += BEAT_MS
            middle.cell.waited_ms = BEAT_MS // 2
            middle.cell.on_frame(cob.SYNC, b"", middle.now_ms)
        middle.cell.waited_ms = 0
        layer_run(middle, 2, moving=False)
        assert estimates(middle)[-1][wire.IDENTITY] == IDENTITY


def test_pause_of_the_background_holds_no_parcel():
    """Garbage is collected for 11 ms, at any time of a beat."""
    machine = run(2, beats=10)
    for pause_at_ms in range(BEAT_MS):
        machine.beat(pause_at_ms, 11)
        for _ in range(5):
            machine.beat()
    check_goes_on(machine)
    assert max(machine.gaps()) <= 3


def test_update_of_five_beats_leaves_the_wheels_to_the_setpoint_watchdog():
    assert run(60).oldest_ms > SETPOINT_TIMEOUT_MS
