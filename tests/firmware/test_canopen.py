"""A cell as the unmodified `canopen` library commissions it, over python-can's virtual bus."""

import struct
import threading
import time
from pathlib import Path

import can
import canopen
import pytest
from canopen.objectdictionary import import_od
from tests.both.bench import cell_bench

from mdms_cell.cell import Cell
from mdms_protocol.codecs import cia402, nmt
from mdms_protocol.dictionary import ENTRIES, ERROR_HISTORY

EDS = Path(__file__).parents[2] / "protocol" / "mdms-cell.eds"
NODE = 5
PATIENCE_S = 10
#: For answers that always come.
ANSWER_S = 2


class RealTime(threading.Thread):
    """Runs a cell with a memory, and wheels that stand still, in real time on a virtual bus."""

    def __init__(self, channel):
        super().__init__()
        self._board = cell_bench.Board()
        self._board.settings = cell_bench.Memory()
        self.cell = Cell(self._board, NODE)
        self._bus = can.Bus(interface="virtual", channel=channel)
        self._running = True

    def run(self):
        start_s = time.monotonic()
        while self._running:
            message = self._bus.recv(0.001)
            if message is not None:
                self.cell.on_frame(message.arbitration_id, bytes(message.data), self.cell.now_ms)
            self.cell.tick()
            self.cell.poll(int((time.monotonic() - start_s) * 1000))
            for can_id, data in self._board.take():
                self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def stop(self):
        self._running = False
        self.join()
        self._bus.shutdown()


@pytest.fixture
def running(request):
    """A cell that runs."""
    running = RealTime(request.node.name)
    yield running
    running.stop()


@pytest.fixture
def remote(request, running):
    """The cell as a node of a `canopen` network, which has heard of it."""
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05  # how long its reader takes to end
    network.connect(interface="virtual", channel=request.node.name)
    running.start()
    remote = network.add_node(NODE, import_od(str(EDS), NODE))
    remote.sdo.RESPONSE_TIMEOUT = ANSWER_S
    remote.nmt.wait_for_heartbeat(PATIENCE_S)
    yield remote
    network.disconnect()


def test_every_readable_object_reads_as_its_default(remote):
    read = 0
    for variable in variables(remote.object_dictionary):
        if variable.index == 0x1003 and variable.subindex:
            continue  # an error that has not been
        raw = remote.sdo.upload(variable.index, variable.subindex)
        if variable.writable or variable.access_type == "const":
            assert variable.decode_raw(raw) == variable.default, variable
        read += 1
    readable = sum(entry.access != "wo" for entry in ENTRIES.values())
    assert read == readable - ERROR_HISTORY


def variables(dictionary):
    for entry in dictionary.values():
        for variable in [entry] if hasattr(entry, "data_type") else entry.values():
            if variable.readable and variable.index >= 0x1000:
                yield variable


def test_segmented_download_and_upload(remote):
    remote.sdo.download(0x3000, 0, struct.pack("<H", 77), force_segment=True)
    assert remote.sdo[0x3000].raw == 77
    assert remote.sdo[0x1009].raw == "2 wheels, 5 sensors"


def test_block_upload(remote):
    with remote.sdo[0x1009].open("rb", block_transfer=True) as stream:
        assert stream.read() == b"2 wheels, 5 sensors"


def test_emergency_reaches_the_host_and_the_history(running, remote):
    deadline_s = time.monotonic() + PATIENCE_S
    remote.nmt.state = "OPERATIONAL"
    while running.cell.state != nmt.OPERATIONAL:
        time.sleep(0.01)
        assert time.monotonic() < deadline_s
    running.cell.fail(0x6100)
    while not remote.emcy.log:
        time.sleep(0.01)
        assert time.monotonic() < deadline_s
    assert remote.emcy.log[0].code == 0x6100
    assert remote.sdo[0x1001].raw == 0x01
    assert remote.sdo[0x1003][0].raw == 1
    assert remote.sdo[0x1003][1].raw == 0x6100 | 6 << 16
    assert cia402.state(remote.sdo[0x6041].raw) == cia402.FAULT


def test_saved_settings_come_back_after_a_reset(remote):
    remote.sdo[0x3000].raw = 77
    remote.store()
    remote.sdo[0x3000].raw = 88
    remote.nmt.send_command(0x81)
    remote.nmt.wait_for_bootup(PATIENCE_S)
    assert remote.sdo[0x3000].raw == 77
    remote.restore()
    remote.nmt.send_command(0x81)
    remote.nmt.wait_for_bootup(PATIENCE_S)
    assert remote.sdo[0x3000].raw == 50
