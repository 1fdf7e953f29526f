"""Both kinds of cells, fed with the same inputs, say the same."""

import numpy as np
import pytest

from mdms_protocol import cob, nmt
from mdms_protocol.frame import Frame
from mdms_sim.nodes.bank import NodeDied
from mdms_sim.nodes.micropython_bank import CHECK_TICKS, MicropythonBank
from mdms_sim.nodes.python_bank import PythonBank

CELLS = 3
BOOT_TICKS = 120


class Bench:
    """A bank with somebody at its frames, who writes down all that the cells do."""

    def __init__(self, bank, seed=1):
        self.bank = bank
        self.heard = []
        self._random = np.random.default_rng(seed)
        self._counts = np.zeros((CELLS, 2), np.int32)
        self._currents_ma = np.zeros((CELLS, 2), np.int32)
        self._presence = np.zeros(CELLS, np.uint8)

    def tick(self, ticks=1):
        for _ in range(ticks):
            self._counts += self._random.integers(-2, 5, (CELLS, 2)).astype(np.int32)
            self._currents_ma[:] = self._random.integers(-900, 900, (CELLS, 2))
            if self._random.random() < 0.02:
                self._presence[:] = self._random.integers(0, 32, CELLS)
            voltages_uv = self.bank.tick(self._counts, self._currents_ma, self._presence)
            self.heard.append(voltages_uv.tolist())
            self.collect()
        return voltages_uv

    def tell(self, can_id, data, cell=None):
        for each in range(CELLS) if cell is None else [cell]:
            self.bank.deliver(each, Frame(can_id, data))
        self.collect()

    def collect(self):
        for cell in range(CELLS):
            self.heard += [(cell, frame) for frame in self.bank.collect(cell)]

    def enable(self, cells=range(CELLS)):
        """Brings the cells to 'operation enabled'."""
        self.tell(cob.NMT, bytes([nmt.START, nmt.ALL_NODES]))
        for word in (0x06, 0x07, 0x0F):
            for cell in cells:
                self.tell(cob.RPDO_BASES[1] + cell + 1, bytes([word, 0, word, 0]), cell)
            self.tick(8)

    def drive(self, ticks):
        """Setpoints and SYNC every 10 ms."""
        for number in range(ticks):
            if number % 10 == 0:
                for cell in range(CELLS):
                    speeds = np.array([30_000 + number, -20_000 * cell], "<i4")
                    self.tell(cob.RPDO_BASES[0] + cell + 1, speeds.tobytes(), cell)
                self.tell(cob.SYNC, b"")
            voltages_uv = self.tick()
        return voltages_uv

    def frames(self, cell, can_id):
        return [
            each[1].data
            for each in self.heard
            if isinstance(each, tuple) and each[0] == cell and each[1].can_id == can_id
        ]


@pytest.fixture(params=[PythonBank, MicropythonBank])
def bench(request):
    bank = request.param(range(1, CELLS + 1))
    yield Bench(bank)
    bank.close()


def test_cells_boot_accept_commands_and_drive(bench):
    bench.tick(BOOT_TICKS)
    assert bench.frames(0, cob.HEARTBEAT_BASE + 1)[0] == b"\x00"
    bench.enable()
    assert np.abs(bench.drive(20)).min() > 0


def test_both_kinds_of_cells_say_the_same_whatever_befalls_them():
    def life(kind):
        bank = kind(range(1, CELLS + 1))
        bench = Bench(bank)
        bench.tick(BOOT_TICKS)
        bench.enable()
        bench.drive(60)
        bank.hang(0)
        bank.set_bus_off(1, True)
        bank.set_drift(2, 20_000)
        bench.drive(60)
        bank.power_off(0)
        bank.set_bus_off(1, False)
        bench.drive(60)
        bank.restart(0, 9)
        bench.drive(BOOT_TICKS)
        bank.close()
        return bench.heard

    assert life(PythonBank) == life(MicropythonBank)


def test_leaving_cells_alone_until_they_are_due_changes_nothing():
    def life(*asked_always):
        bench = Bench(PythonBank(range(1, CELLS + 1)), seed=3)
        for cell in asked_always:
            # Where a clock may be of its own, the bank asks every cell at every tick.
            bench.bank.set_drift(cell, 0)
        bench.tick(BOOT_TICKS)
        bench.tell(cob.SDO_REQUEST_BASE + 2, bytes.fromhex("2b17100017000000"), 1)
        bench.enable()
        bench.drive(100)
        bench.bank.set_bus_off(1, True)
        bench.drive(30)
        bench.bank.set_bus_off(1, False)
        bench.tick(100)
        bench.enable()
        bench.drive(100)
        return bench.heard

    assert life() == life(0)


def test_a_hung_cell_leaves_its_voltages_on_and_says_nothing(bench):
    bench.tick(BOOT_TICKS)
    bench.enable()
    before = bench.drive(20)
    bench.bank.hang(1)
    said = len([each for each in bench.heard if each[0] == 1])
    after = bench.drive(200)
    assert after[1].tolist() == before[1].tolist()
    assert after[0].tolist() != before[0].tolist()
    assert len([each for each in bench.heard if each[0] == 1]) == said


def test_a_cell_without_power_drives_nothing_and_boots_again_as_another_node(bench):
    bench.tick(BOOT_TICKS)
    bench.enable()
    bench.drive(20)
    bench.bank.power_off(2)
    assert bench.drive(20)[2].tolist() == [0, 0]
    bench.bank.restart(2, 77)
    assert (cob.SDO_REQUEST_BASE + 77) in bench.bank.accepts(2)
    assert (cob.SDO_REQUEST_BASE + 3) not in bench.bank.accepts(2)
    bench.tick(BOOT_TICKS)
    assert bench.frames(2, cob.HEARTBEAT_BASE + 77)[0] == b"\x00"


def test_a_cell_that_leaves_the_bus_cuts_its_motors_until_it_is_reset(bench):
    bench.tick(BOOT_TICKS)
    bench.enable()
    bench.drive(20)
    bench.bank.set_bus_off(0, True)
    assert bench.drive(20)[0].tolist() == [0, 0]
    bench.bank.set_bus_off(0, False)
    assert bench.drive(20)[0].tolist() == [0, 0]


def test_a_fast_clock_sends_more_heartbeats(bench):
    bench.tick(BOOT_TICKS)
    bench.bank.set_drift(1, 100_000)
    bench.tick(2000)
    counts = [len(bench.frames(cell, cob.HEARTBEAT_BASE + cell + 1)) for cell in range(CELLS)]
    assert counts[0] == counts[2]
    assert 1.05 < counts[1] / counts[0] < 1.15


def test_the_filter_follows_what_the_cell_listens_to(bench):
    accepted = bench.bank.accepts(0)
    assert cob.SYNC not in accepted
    bench.tick(BOOT_TICKS)
    wanted = {cob.NMT, cob.SYNC, cob.LSS_REQUEST, cob.SDO_REQUEST_BASE + 1, cob.RPDO_BASES[0] + 1}
    assert all(can_id in accepted for can_id in wanted)
    assert cob.RPDO_BASES[0] + 2 not in accepted


def test_an_exception_in_a_process_is_reported_with_its_text(monkeypatch, tmp_path):
    from mdms_sim.nodes import micropython_process

    main = tmp_path / "micropython_main.py"
    main.write_text("print('before')\nraise ValueError('the cause')\n")
    monkeypatch.setattr(micropython_process, "_MAIN", main)
    with pytest.raises(NodeDied, match=r"cell 5 has died: before\n(.|\n)*ValueError: the cause"):
        MicropythonBank([5])


def test_a_process_that_was_killed_is_noticed():
    bank = MicropythonBank([1, 2])
    bank._processes[1]._process.kill()
    with pytest.raises(NodeDied, match="cell 2 has died: it said nothing"):
        rest(bank, CHECK_TICKS)
    bank.close()


def rest(bank, ticks):
    for _ in range(ticks):
        bank.tick(*np.zeros((2, 2, 2), np.int32), np.zeros(2, np.uint8))


def test_without_micropython_the_way_out_is_named(monkeypatch):
    from mdms_sim.nodes import micropython_process
    from mdms_sim.nodes.bank import MicropythonMissing

    monkeypatch.setattr(micropython_process, "find_spec", lambda name: None)
    with pytest.raises(MicropythonMissing, match="--nodes cpython"):
        MicropythonBank([1])


def test_any_number_of_frames_between_two_ticks_is_taken(bench):
    bench.tick(BOOT_TICKS)
    request = bytes.fromhex("4018100100000000")
    for _ in range(1000):
        bench.bank.deliver(0, Frame(cob.SDO_REQUEST_BASE + 1, request))
    # The board keeps 64 frames at most when nobody takes them.
    answers = [each for each in bench.bank.collect(0) if each.can_id == cob.SDO_RESPONSE_BASE + 1]
    assert len(answers) >= 64
    bench.tick()
