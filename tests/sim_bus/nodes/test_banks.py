"""Both kinds of cells, fed with the same inputs, say the same."""

import numpy as np
import pytest
from tests.sim_bus.nodes.bench import BOOT_TICKS, CELLS, Bench

from mdms_protocol import indices
from mdms_protocol.codecs import cob, sdo, update
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.bank import NodeDied
from mdms_sim.nodes.micropython_bank import CHECK_TICKS, MicropythonBank
from mdms_sim.nodes.python_bank import PythonBank


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
        restart = sdo.write_request(indices.PROGRAM_CONTROL, 1, bytes([update.RESET]))
        bank.restart(2)
        bench.drive(BOOT_TICKS)
        bank.deliver(2, Frame(cob.SDO_REQUEST_BASE + 3, restart))
        bench.drive(2 * BOOT_TICKS)
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


def test_the_cell_that_is_meant_blinks_until_its_power_is_gone(bench):
    bench.tick(BOOT_TICKS)
    bench.tell(cob.SDO_REQUEST_BASE + 2, bytes.fromhex("2b073000e8030000"), 1)
    bench.tick(2)
    assert bench.bank.blinking.tolist() == [cell == 1 for cell in range(CELLS)]
    bench.bank.power_off(1)
    assert not bench.bank.blinking.any()


def test_the_filter_follows_the_identifiers_of_the_cell(bench):
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
