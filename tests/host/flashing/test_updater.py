"""Many cells at once in virtual time: firmware cells, whose frames pass at once."""

import numpy as np
import pytest

from mdms_host.flashing.bundles import Bundle, sign
from mdms_host.flashing.cell_update import CellUpdate
from mdms_host.flashing.updater import Updater
from mdms_protocol import indices
from mdms_protocol.codecs import bundle as heads
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.nodes.virtual_board import VirtualBoard

KEY = bytes(range(32))
PACKED = b"\x00\x20\x00\x00" + bytes([number * 13 & 0xFF for number in range(3000)])
BITRATE = 1_000_000


class Cells:
    """Firmware cells with the array's key, and a bus that is never full."""

    def __init__(self, count=3):
        self.bank = PythonBank(range(1, count + 1))
        self.count = count
        for cell in range(count):
            self.bank._flash[cell].files.replace("update.key", KEY)
            self.bank.restart(cell)
        self.now_s = 0.0
        self.deaf = set()
        #: Called every millisecond of an update.
        self.hand = lambda: None
        self._lost = (b"", -1)
        for _ in range(100):
            self._tick()

    def _tick(self):
        counts = np.zeros((self.count, 2), np.int32)
        self.bank.tick(counts, counts, np.zeros(self.count, np.uint8))
        self.now_s += 0.001
        return [frame for _, frames in self.bank.collect_all() for frame in frames]

    def run(self, updates, limit_s=120.0, slow=1):
        """To the end; the time of the cells passes so many times more slowly than the updater's."""
        updater = Updater(updates, BITRATE)
        end_s = self.now_s + limit_s
        while not updater.over:
            assert self.now_s < end_s
            if updater.wake_s <= self.now_s * slow:
                for frame in updater.poll(self.now_s * slow):
                    for cell in set(range(self.count)) - self.deaf:
                        self.bank.deliver(cell, frame)
            self.hand()
            for frame in self._tick():
                if self._loses(frame.data):
                    continue
                updater.on_frame(frame, self.now_s * slow)
        return updater

    def lose(self, start, number):
        """Of the frames that begin so, that of a number, from 0, gets lost."""
        self._lost = (start, number)

    def _loses(self, data):
        start, number = self._lost
        if not data.startswith(start):
            return False
        self._lost = (start, number - 1)
        return number == 0

    def every(self, period_s, act, times=1000):
        """Do something to the cells that often while updates run."""
        due_s = [self.now_s + period_s * (number + 1) for number in range(times)]

        def hand():
            if due_s and self.now_s >= due_s[0]:
                del due_s[0]
                act()

        self.hand = hand

    def running(self):
        return [board.slots.identification for board in self.bank._boards]


def bundle(counter=1, **changes) -> Bundle:
    return sign(PACKED, KEY, counter, VirtualBoard.bytecode, **changes)


def updates(cells, sent):
    return [CellUpdate(node_id, sent) for node_id in range(1, cells.count + 1)]


def test_all_cells_run_the_bundle_in_the_end_and_have_confirmed_it():
    cells, sent = Cells(), bundle()
    updater = cells.run(updates(cells, sent))
    assert all(each.finished and each.share == 1.0 for each in updater.updates)
    assert cells.running() == [sent.identification] * 3
    for cell in range(3):
        cells.bank.restart(cell)
    assert cells.running() == [sent.identification] * 3
    assert updater.frames > 3 * len(sent.data) / 7
    assert 0 < updater.load(BITRATE) < 1


def test_bus_is_given_no_more_frames_than_it_carries():
    cells, sent = Cells(), bundle()
    updater = Updater(updates(cells, sent), BITRATE)
    frames = sum(len(list(updater.poll(number * 1e-4))) for number in range(1000))
    assert frames <= 0.1 / updater._frame_s + 17


def test_cells_stay_as_they_are_when_the_one_that_went_ahead_fails(monkeypatch):
    cells, sent = Cells(), bundle()
    # A cell that starts it does not pass its self-test.
    monkeypatch.setattr("mdms_cell.cell.Cell._sound", lambda self: False)
    monkeypatch.setattr("mdms_cell.update.TRIAL_MS", 8_000)
    updater = cells.run(updates(cells, sent))
    first, *others = updater.updates
    failures = {each.failure for each in updater.updates}
    assert "it does not pass its self-test" in failures
    assert len(failures) == 2
    assert sum(running != 0 for running in cells.running()) == 1
    assert any("which went ahead, has failed" in each.failure for each in (first, *others))
    for _ in range(8_100):
        cells._tick()
    assert cells.running() == [0] * 3


def test_answer_to_start_or_confirm_that_gets_lost_costs_nothing():
    for number in (1, 2):  # the first is that to 'clear'
        cells, sent = Cells(1), bundle()
        cells.lose(b"\x60\x51\x1f\x01", number)
        (update,) = cells.run(updates(cells, sent)).updates
        assert update.finished, update.failure
        assert cells.running() == [sent.identification]


def test_boot_up_message_that_gets_lost_costs_no_cell_its_firmware():
    cells, sent = Cells(), bundle()
    cells.lose(bytes((nmt.INITIALISING,)), 0)
    updater = cells.run(updates(cells, sent))
    assert [each.failure for each in updater.updates] == [None] * 3
    assert cells.running() == [sent.identification] * 3


def test_cell_whose_time_passes_slowly_is_given_time_for_its_self_test():
    cells, sent = Cells(), bundle()
    updater = cells.run(updates(cells, sent), slow=4)
    assert [each.failure for each in updater.updates] == [None] * 3
    assert cells.running() == [sent.identification] * 3


def test_cell_that_falls_silent_keeps_no_other_from_its_firmware():
    cells, sent = Cells(), bundle()
    cells.deaf = {1}
    updater = cells.run(updates(cells, sent))
    assert [each.finished for each in updater.updates] == [True, False, True]
    assert "no answer" in updater.updates[1].failure


def ask(cells):
    """Another program reads the serial number of the first cell."""
    request = sdo.read_request(indices.IDENTITY, 4)
    cells.bank.deliver(0, Frame(cob.SDO_REQUEST_BASE + 1, request))


def test_requests_of_another_program_delay_an_update_only():
    cells, sent = Cells(1), bundle()
    cells.every(0.02, lambda: ask(cells), times=15)
    (update,) = cells.run(updates(cells, sent)).updates
    assert update.finished, update.failure
    assert update.restarts == 1


def test_transfer_that_is_broken_off_on_a_slow_table_delays_an_update_only():
    cells, sent = Cells(1), bundle()
    cells.every(0.02, lambda: ask(cells), times=1)
    (update,) = cells.run(updates(cells, sent), slow=4).updates
    assert update.finished, update.failure


def test_update_that_gets_further_each_time_is_not_given_up():
    cells, sent = Cells(1), bundle()
    (update,) = updates(cells, sent)
    shares = [0.1, 0.3, 0.5, 0.7, 0.9]

    def hand():
        if shares and update.share >= shares[0]:
            del shares[0]
            ask(cells)

    cells.hand = hand
    cells.run([update])
    assert update.finished, update.failure
    assert update.restarts == 5


def test_program_that_never_ends_its_requests_is_named():
    cells, sent = Cells(1), bundle()
    cells.every(0.02, lambda: ask(cells))
    (update,) = cells.run(updates(cells, sent)).updates
    assert "another program asks it amid the transfer" in update.failure
    assert cells.running() == [0]


def test_cell_that_restarts_amid_its_transfer_takes_it_from_the_beginning():
    cells, sent = Cells(), bundle()
    cells.every(0.03, lambda: cells.bank.restart(0), times=1)
    updater = cells.run(updates(cells, sent))
    assert all(each.finished for each in updater.updates)
    assert [each.restarts for each in updater.updates] == [1, 0, 0]
    assert cells.running() == [sent.identification] * 3


def test_cell_that_restarts_while_it_waits_for_the_first_takes_the_bundle_again():
    cells, sent = Cells(), bundle()
    updating = updates(cells, sent)

    def hand():
        if updating[1].loaded and not updating[1].may_start:
            cells.bank.restart(1)
            cells.hand = lambda: None

    cells.hand = hand
    updater = cells.run(updating)
    assert [each.failure for each in updater.updates] == [None] * 3
    assert cells.running() == [sent.identification] * 3


def test_cell_that_restarts_again_and_again_is_named_with_a_cure():
    cells, sent = Cells(), bundle()
    busy = []

    def hand():
        busy.extend([None] * cells.bank._cells[1]._sdo.busy)
        if len(busy) == 20:
            busy.clear()
            cells.bank.restart(1)

    cells.hand = hand
    updater = cells.run(updates(cells, sent))
    assert [each.finished for each in updater.updates] == [True, False, True]
    assert "it restarted amid the transfer; look at its supply" in updater.updates[1].failure


@pytest.mark.parametrize(
    ("sent", "reason"),
    [
        (lambda: bundle(counter=0), "has been used before"),
        (lambda: bundle(version="0.0.9"), "--allow-older"),
        (lambda: bundle(boards=(1,)), "for other boards"),
        (lambda: sign(PACKED, bytes(32), 1, VirtualBoard.bytecode), "another array's key"),
        (lambda: sign(PACKED, KEY, 1, 0), "another version of MicroPython"),
        (lambda: Bundle(bundle().head, bundle().data[:-1]), "not whole"),
        (lambda: Bundle(bundle().head, bytes(heads.HEAD_SIZE)), "no bundle"),
        (
            lambda: Bundle(bundle().head, bundle().data[:-1] + b"x"),
            "differs from the signed bundle",
        ),
    ],
)
def test_refusal_of_a_cell_is_told_in_words(sent, reason):
    cells = Cells(1)
    (update,) = cells.run(updates(cells, sent())).updates
    assert reason in update.failure
    assert cells.running() == [0]
    # A right bundle is taken after that.
    (update,) = cells.run(updates(cells, bundle())).updates
    assert update.finished
    assert update.restarts == 0


def test_bundle_is_the_same_for_the_same_firmware_key_and_counter():
    assert bundle().data == bundle().data
    assert bundle(2).data != bundle(1).data
    assert bundle(older=True).data != bundle().data
