"""The LSS master against the firmware's LSS slaves, whose answers may come late or many at once."""

from heapq import heappop, heappush
from queue import Empty
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdms_cell.canopen.nmt import Lss
from mdms_host.commissioning.lss_master import LssAddress, LssError, LssMaster
from mdms_protocol.codecs import cob, lss, sdo
from mdms_protocol.dictionary import PRODUCT_CODE, REVISION, VENDOR_ID

OURS = (VENDOR_ID, PRODUCT_CODE, REVISION)


class Slave:
    """One LSS slave of the firmware; a reset is told by `booted`."""

    def __init__(self, address, node_id=cob.NODE_NONE, refusal=None):
        self.pending_node_id = node_id
        self.booted = None
        self.saved = None
        self.answers = []
        self._refusal = refusal
        self.lss = Lss(tuple(address), self, self._save, self._send)

    def on_lss_done(self):
        if self.pending_node_id != cob.NODE_NONE:
            self.booted = self.pending_node_id

    def _save(self, node_id):
        if self._refusal:
            raise sdo.AbortError(self._refusal)
        self.saved = node_id

    def _send(self, can_id, data):
        assert can_id == cob.LSS_RESPONSE
        self.answers.append(bytes(data))
        return True


class Answers:
    """The master's queue in virtual time: a wait for an answer takes none of the machine."""

    def __init__(self):
        self._now_s = 0.0
        self._coming = []
        self._count = 0

    def put(self, data, late_s=0.0):
        self._count += 1
        heappush(self._coming, (self._now_s + late_s, self._count, data))

    def empty(self):
        return not self._coming or self._coming[0][0] > self._now_s

    def get(self, timeout=0.0):
        if self.empty():
            end_s = self._now_s + timeout
            self._now_s = min(end_s, self._coming[0][0]) if self._coming else end_s
        if self.empty():
            raise Empty
        return heappop(self._coming)[-1]


class Bus:
    """Takes the master's requests to the slaves; `late` may hold an answer back for some time.

    Each frame gets lost with the probability `lost`.
    """

    def __init__(self, *slaves, late=lambda _number: 0.0, lost=0.0, seed=1):
        self.slaves = slaves
        self.master = LssMaster(self._send)
        self.master._answers = Answers()
        self.requests = []
        self._late = late
        self._lost, self._chance = lost, Random(seed).random

    def _arrives(self):
        return self._chance() >= self._lost

    def _send(self, frame):
        assert frame.can_id == cob.LSS_REQUEST
        assert len(frame.data) == 8
        self.requests.append(frame.data)
        if not self._arrives():
            return
        late_s = self._late(len(self.requests))
        for slave in self.slaves:
            slave.lss.on_request(frame.data)
            answers, slave.answers = slave.answers, []
            for answer in filter(lambda _answer: self._arrives(), answers):
                self.master._answers.put(answer, late_s)


def ours(serial):
    return LssAddress(*OURS, serial)


def test_blank_cells_are_found_in_the_order_of_their_serial_numbers():
    serials = [0xCAFE0001, 7, 0x80000000, 0xCAFE0000]
    bus = Bus(*(Slave(ours(serial)) for serial in serials), Slave(ours(3), node_id=5))
    assert bus.master.any_blank()
    assert bus.master.find_blank() == [ours(serial) for serial in sorted(serials)]
    assert [slave.booted for slave in bus.slaves[:4]] == [None] * 4


def test_nobody_is_found_where_nobody_is_blank():
    bus = Bus(Slave(ours(3), node_id=5))
    assert not bus.master.any_blank()
    assert bus.master.find_blank() == []


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 0xFFFFFFFF))
def test_any_serial_number_is_found(serial):
    assert Bus(Slave(ours(serial))).master.find_blank() == [ours(serial)]


def test_a_stranger_is_found_by_all_of_its_identity():
    address = LssAddress(0x319, PRODUCT_CODE, 0x00020001, 5)
    bus = Bus(Slave(address), Slave(ours(9)))
    assert bus.master.find_blank() == [ours(9), address]


@pytest.mark.parametrize("lost", [1, 2])
def test_a_lost_question_whether_there_are_more_ends_no_scan(lost):
    bus = Bus(Slave(ours(7)), Slave(ours(9)))
    question = bytes((lss.FAST_SCAN, 0, 0, 0, 0, lss.SCAN_ALL, 0, 0))
    send, asked = bus.master._send_frame, []

    def lossy(frame):
        asked.extend([frame] * (frame.data == question))
        if frame.data != question or len(asked) != lost:
            send(frame)

    bus.master._send_frame = lossy
    assert bus.master.find_blank() == [ours(7), ours(9)]


@pytest.mark.parametrize("seed", range(4))
def test_all_cells_are_found_where_frames_get_lost(seed):
    serials = [5, 6, 0x1234, 0x80000000, 0xCAFE0001]
    bus = Bus(*(Slave(ours(serial)) for serial in serials), lost=0.02, seed=seed)
    assert bus.master.find_blank() == [ours(serial) for serial in serials]
    assert bus.master.find_beside([6]) == [5, *serials[2:]]


@pytest.mark.parametrize("seed", range(4))
def test_a_cell_takes_its_node_id_where_frames_get_lost(seed):
    bus = Bus(Slave(ours(1)), lost=0.02, seed=seed)
    for node_id in range(1, 8):
        bus.master.select(ours(1))
        assert bus.master.any_blank() == (node_id == 1)
        bus.master.set_node_id(node_id)
        assert bus.master.pending_node_id() == node_id
        assert bus.master.store()
        bus.master.leave()
        assert (bus.slaves[0].booted, bus.slaves[0].saved) == (node_id, node_id)


def test_few_requests_are_enough_for_our_own():
    bus = Bus(Slave(ours(0xFFFF)))
    bus.master.find_blank()
    assert len({*bus.requests}) < 50


def test_an_answer_that_comes_too_late_does_not_name_a_cell_that_is_not_there():
    # The four copies of the first question about the serial number, whose upper bits are 0.
    bus = Bus(Slave(ours(5)), late=lambda number: 0.03 if 46 <= number < 50 else 0.0)
    assert bus.master.find_blank() == [ours(5)]


def test_selected_cell_takes_and_keeps_its_node_id_and_no_other_does():
    bus = Bus(Slave(ours(1)), Slave(ours(2)))
    bus.master.select(ours(2))
    bus.master.set_node_id(17)
    assert bus.master.store() is True
    assert (bus.slaves[1].pending_node_id, bus.slaves[1].saved) == (17, 17)
    assert bus.slaves[1].booted is None
    bus.master.leave()
    assert bus.slaves[1].booted == 17
    assert bus.slaves[0].pending_node_id == cob.NODE_NONE


def test_a_device_that_answers_every_question_ends_the_search():
    bus = Bus(Slave(ours(1), node_id=5))
    bus.slaves[0].lss.on_request = lambda _data: bus.slaves[0].answers.append(
        bytes((lss.IDENTIFIED,)) + bytes(7)
    )
    with pytest.raises(LssError, match="answers to any serial number"):
        bus.master.find_beside([1])


def test_an_absent_cell_cannot_be_selected():
    with pytest.raises(LssError, match="no cell answers to serial number 00000004"):
        Bus(Slave(ours(1))).master.select(ours(4))


def test_two_cells_of_one_serial_number_are_told_and_not_configured():
    bus = Bus(Slave(ours(1)), Slave(ours(1)))
    with pytest.raises(LssError, match="two cells have the serial number 00000001"):
        bus.master.select(ours(1))
    with pytest.raises(LssError, match="the selected cell does not answer"):
        bus.master.set_node_id(4)


def test_a_cell_that_another_master_has_found_meanwhile_takes_no_node_id():
    bus = Bus(Slave(ours(1)), Slave(ours(2)))
    bus.master.select(ours(1))
    # The search of the other has come to its end.
    bus.slaves[1].lss.on_request(bytes((lss.FAST_SCAN, 0, 0, 0, 0, lss.SCAN_ALL, 0, 0)))
    for part, number in enumerate(ours(2)):
        place = bytes((0, part, (part + 1) % 4))
        bus.slaves[1].lss.on_request(bytes((lss.FAST_SCAN,)) + number.to_bytes(4, "little") + place)
    bus.slaves[1].answers.clear()
    with pytest.raises(LssError, match="more than one cell has taken node id 17"):
        bus.master.set_node_id(17)
    assert [slave.pending_node_id for slave in bus.slaves] == [cob.NODE_NONE] * 2
    assert [(slave.booted, slave.saved) for slave in bus.slaves] == [(None, None)] * 2
    bus.master.select(ours(1))
    bus.master.set_node_id(17)
    bus.master.leave()
    assert [slave.booted for slave in bus.slaves] == [17, None]


def test_a_refusal_is_told():
    bus = Bus(Slave(ours(1), refusal=sdo.HARDWARE_ERROR))
    bus.master.select(ours(1))
    with pytest.raises(LssError, match="refuses LSS command 0x11: 1"):
        bus.master.set_node_id(200)
    bus.master.set_node_id(4)
    with pytest.raises(LssError, match="refuses LSS command 0x17: 2"):
        bus.master.store()


def test_a_cell_without_a_memory_for_settings_takes_its_node_id_and_does_not_keep_it():
    bus = Bus(Slave(ours(1), refusal=sdo.CANNOT_STORE))
    bus.master.select(ours(1))
    bus.master.set_node_id(4)
    assert bus.master.store() is False
    bus.master.leave()
    assert bus.slaves[0].booted == 4
