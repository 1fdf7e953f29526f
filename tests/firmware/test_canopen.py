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
from mdms_protocol.codecs import cia402
from mdms_protocol.dictionary import ENTRIES, ERROR_HISTORY

EDS = Path(__file__).parents[2] / "protocol" / "mdms-cell.eds"
NODE = 5
PATIENCE_S = 10
#: For answers that always come.
ANSWER_S = 2


class Settings:
    """Two banks of memory."""

    def __init__(self):
        self.banks = [bytes(4096), bytes(4096)]

    def read(self, bank):
        return self.banks[bank]

    def erase(self, bank):
        self.banks[bank] = b"\xff" * 4096

    def write(self, bank, offset, data):
        old = self.banks[bank]
        self.banks[bank] = old[:offset] + data + old[offset + len(data) :]


class Board(cell_bench.Board):
    """Wheels that stand still, and memories that keep their writes."""

    def __init__(self, serial):
        super().__init__()
        self.serial = serial
        self.settings = Settings()


class Cells(threading.Thread):
    """Runs cells in real time on a virtual bus."""

    def __init__(self, channel, node_ids):
        super().__init__()
        self.boards = [Board(0x1000 + number) for number in range(len(node_ids))]
        self.cells = [
            Cell(board, node_id) for board, node_id in zip(self.boards, node_ids, strict=True)
        ]
        self._bus = can.Bus(interface="virtual", channel=channel)
        self._running = True

    def run(self):
        start_s = time.monotonic()
        while self._running:
            message = self._bus.recv(0.001)
            if message is not None:
                self._to_cells(message.arbitration_id, bytes(message.data))
            now_ms = int((time.monotonic() - start_s) * 1000)
            for cell in self.cells:
                cell.tick()
                cell.poll(now_ms)
            self._from_cells()

    def _to_cells(self, can_id, data, sender=None):
        for cell in self.cells:
            if cell is not sender:
                cell.on_frame(can_id, data, cell.now_ms)

    def _from_cells(self):
        for cell, board in zip(self.cells, self.boards, strict=True):
            for can_id, data in board.take():
                self._to_cells(can_id, data, cell)
                self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def stop(self):
        self._running = False
        self.join()
        self._bus.shutdown()


@pytest.fixture
def run_cells(request):
    """Starts cells with these node ids and a `canopen` network beside them."""
    opened = []

    def start(*node_ids):
        cells = Cells(request.node.name, node_ids)
        network = canopen.Network()
        network.NOTIFIER_CYCLE = 0.05  # how long its reader takes to end
        network.connect(interface="virtual", channel=request.node.name)
        opened.append((cells, network))
        cells.start()
        return cells, network

    yield start
    for cells, network in opened:
        cells.stop()
        network.disconnect()


@pytest.fixture
def node(run_cells):
    cells, network = run_cells(NODE)
    remote = network.add_node(NODE, import_od(str(EDS), NODE))
    remote.sdo.RESPONSE_TIMEOUT = ANSWER_S
    remote.nmt.wait_for_heartbeat(PATIENCE_S)
    return cells, remote


def test_every_readable_object_reads_as_its_default(node):
    _, remote = node
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


def test_segmented_download_and_upload(node):
    _, remote = node
    remote.sdo.download(0x3000, 0, struct.pack("<H", 77), force_segment=True)
    assert remote.sdo[0x3000].raw == 77
    assert remote.sdo[0x1009].raw == "2 wheels, 5 sensors"


def test_block_upload(node):
    _, remote = node
    with remote.sdo[0x1009].open("rb", block_transfer=True) as stream:
        assert stream.read() == b"2 wheels, 5 sensors"


def test_emergency_reaches_the_host_and_the_history(node):
    cells, remote = node
    remote.nmt.state = "OPERATIONAL"
    cells.cells[0].fail(0x6100)
    deadline_s = time.monotonic() + PATIENCE_S
    while not remote.emcy.log:
        time.sleep(0.01)
        assert time.monotonic() < deadline_s
    assert remote.emcy.log[0].code == 0x6100
    assert remote.sdo[0x1001].raw == 0x01
    assert remote.sdo[0x1003][0].raw == 1
    assert remote.sdo[0x1003][1].raw == 0x6100 | 6 << 16
    assert cia402.state(remote.sdo[0x6041].raw) == cia402.FAULT


def test_saved_settings_come_back_after_a_reset(node):
    _, remote = node
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
