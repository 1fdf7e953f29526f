"""MicroPython cells: frames that wait for a turn, leftovers, and processes that end with theirs."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from mdms_cell.drive import speed_loop
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt, sdo, update
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes import lockstep, micropython_bank, micropython_process
from mdms_sim.nodes.bank import NodeDied, NodeHangs
from mdms_sim.nodes.micropython_bank import MicropythonBank
from mdms_sim.nodes.micropython_process import Blocks
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.nodes.virtual_board import TRANSMIT_QUEUE

BOOT_TICKS = 120
RPDO1 = cob.RPDO_BASES[0] + 1
SDO_REQUEST = cob.SDO_REQUEST_BASE + 1
SETPOINT = bytes([0x10, 0x27, 0, 0] * 2)


def started(kind):
    """One cell in 'operational'."""
    bank = kind([1])
    tick(bank, BOOT_TICKS)
    bank.deliver(0, Frame(cob.NMT, bytes([nmt.START, 1])))
    bank.collect(0)
    return bank


def tick(bank, ticks=1):
    """The frames of so many ticks."""
    said = []
    for _ in range(ticks):
        bank.tick(*np.zeros((2, 1, 2), np.int32), np.zeros(1, np.uint8))
        said.append(list(bank.collect(0)))
    return said


def say(bank, can_id, data):
    bank.deliver(0, Frame(can_id, data))
    return list(bank.collect(0))


@pytest.fixture
def bank():
    bank = started(MicropythonBank)
    yield bank
    bank.close()


def test_a_setpoint_waits_for_the_next_turn_and_an_inquiry_does_not(bank):
    asked = []
    process = bank._processes[0]
    ask, process.ask = process.ask, lambda request: asked.append(request) or ask(request)
    bank.deliver(0, Frame(RPDO1, SETPOINT))
    assert bank.collect(0) == []
    assert asked == []
    bank.deliver(0, Frame(SDO_REQUEST, bytes.fromhex("40ff600000000000")))
    assert len(asked) == 1
    assert [frame.can_id for frame in bank.collect(0)] == [cob.SDO_RESPONSE_BASE + 1]


def test_setpoints_without_end_are_taken_in(bank):
    for _ in range(1000):
        bank.deliver(0, Frame(RPDO1, SETPOINT))
    bank.deliver(0, Frame(SDO_REQUEST, bytes.fromhex("4002300100000000")))
    (answer,) = bank.collect(0)
    received = int.from_bytes(answer.data[4:], "little")
    assert received >= 1000


def test_an_identifier_that_has_become_that_of_sync_is_answered_at_once():
    def life(kind):
        bank = started(kind)
        heard = [say(bank, RPDO1, b""), *tick(bank, 3)]
        heard.append(
            say(bank, SDO_REQUEST, bytes.fromhex("23051000") + RPDO1.to_bytes(4, "little"))
        )
        heard += [say(bank, RPDO1, b""), *tick(bank, 3)]
        bank.close()
        return heard

    heard = life(MicropythonBank)
    assert [frame.can_id for frame in heard[5]] == [cob.TPDO_BASES[0] + 1]
    assert heard == life(PythonBank)


def test_both_kinds_of_cells_drop_the_same_frames_when_nobody_takes_them():
    def life(kind):
        bank = started(kind)
        for _ in range(2 * TRANSMIT_QUEUE):
            bank.deliver(0, Frame(SDO_REQUEST, bytes.fromhex("4018100100000000")))
        heard = [list(bank.collect(0)), list(bank.collect(0)), *tick(bank, 3)]
        bank.close()
        return heard

    heard = life(MicropythonBank)
    assert len(heard[0]) == TRANSMIT_QUEUE
    assert heard == life(PythonBank)


def test_a_cell_that_restarts_itself_still_measures_its_supply(bank):
    bank.set_supply(0, 12_000_000)
    reset = sdo.write_request(indices.PROGRAM_CONTROL, 1, bytes([update.RESET]))
    say(bank, SDO_REQUEST, reset)
    assert any(frame.data == b"\0" for said in tick(bank, 800) for frame in said)
    (answer,) = say(bank, SDO_REQUEST, sdo.read_request(indices.SUPPLY, 0))
    assert int.from_bytes(answer.data[4:], "little") == 12_000


def test_an_answer_to_a_frame_that_was_to_have_none_is_told_of(monkeypatch, tmp_path):
    source = micropython_process._MAIN.read_text()
    ours = micropython_process._MAIN.parent
    main = tmp_path / "main.py"
    broken = source.replace("self.cell.silent()", f"[{SDO_REQUEST}]")
    assert broken != source
    main.write_text(f"import sys\nsys.path.insert(0, {str(ours)!r})\n{broken}")
    monkeypatch.setattr(micropython_process, "_MAIN", main)
    bank = started(MicropythonBank)
    try:
        bank.deliver(0, Frame(SDO_REQUEST, bytes.fromhex("4018100100000000")))
        with pytest.raises(NodeDied, match="may have waited has been answered"):
            tick(bank)
    finally:
        bank.close()


def descriptors():
    return set(os.listdir("/dev/fd"))


def test_a_closed_bank_leaves_no_files_processes_or_memory_behind():
    before = descriptors()
    bank = MicropythonBank([1, 2, 3])
    children = [process._process for process in bank._processes]
    bank.close()
    bank.close()
    assert all(child.returncode == 0 for child in children)
    assert descriptors() == before


def test_a_bank_that_cannot_start_leaves_nothing_behind_either(monkeypatch):
    made = []

    class Failing(micropython_bank.MicropythonProcess):
        def __init__(self, *arguments):
            if len(made) == 2:
                raise OSError("no more processes")
            super().__init__(*arguments)
            made.append(self._process)

    monkeypatch.setattr(micropython_bank, "MicropythonProcess", Failing)
    before = descriptors()
    with pytest.raises(OSError, match="no more processes"):
        MicropythonBank([1, 2, 3])
    assert [child.returncode for child in made] == [0, 0]
    assert descriptors() == before


def test_processes_end_when_the_simulation_is_killed():
    program = (
        "from mdms_sim.nodes.micropython_bank import MicropythonBank\n"
        "bank = MicropythonBank([1, 2])\n"
        "print(*(each._process.pid for each in bank._processes), flush=True)\n"
        "input()\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with parent:
        children = [int(each) for each in parent.stdout.readline().split()]
        assert all(alive(child) for child in children)
        parent.send_signal(signal.SIGKILL)
    deadline_s = time.monotonic() + 10
    while any(alive(child) for child in children):
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_block_has_room_for_all_that_is_put_into_it():
    assert lockstep.WORDS * lockstep.WORD == lockstep.REGISTERS
    assert lockstep.REGISTERS + lockstep.WORD * speed_loop.REGISTERS <= lockstep.INBOX
    lists = 2 * (lockstep.FRAME_HEAD_SIZE + 255)
    assert TRANSMIT_QUEUE * lockstep.FRAME_MAX + lists <= lockstep.OUTBOX_MAX
    assert lockstep.BLOCK % lockstep.WORD == 0


def test_frames_are_added_to_an_inbox_until_it_is_full():
    blocks = Blocks(2)
    fitting = 1
    while blocks.put(1, 0x201, SETPOINT):
        fitting += 1
    blocks.close()
    assert fitting == lockstep.INBOX_MAX // lockstep.FRAME_MAX


def test_process_that_hangs_is_named_within_five_seconds_and_ended(monkeypatch):
    assert micropython_process._ANSWER_S < 5.0
    bank = MicropythonBank([1, 7])
    try:
        tick(bank, BOOT_TICKS)
        monkeypatch.setattr(micropython_process, "_ANSWER_S", 1.0)
        tick(bank)
        process = bank._processes[1]._process
        os.kill(process.pid, signal.SIGSTOP)
        with pytest.raises(NodeHangs, match=r"cell 7 hangs: no answer for 1 s; its process was"):
            tick(bank)
        assert process.poll() == -signal.SIGKILL
    finally:
        bank.close()
