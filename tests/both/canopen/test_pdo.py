"""PDOs: when they are taken over and sent, and how they may be remapped."""

from refusal import code_of

from mdms_cell import ticks
from mdms_cell.canopen.objects import Objects, find
from mdms_cell.canopen.pdos import Rpdo, Tpdo
from mdms_protocol import record
from mdms_protocol.codecs import sdo

#: Bit 30 of a TPDO's COB-ID: it answers no remote request.
NO_REMOTE = 1 << 30


class Bench:
    """The first RPDO and TPDO of a node 5, with two live targets and two live speeds."""

    def __init__(self):
        self.objects = Objects()
        self.objects.reset(5, record.FROM_NODE)
        self.values = {}
        self.presence = 0
        self.changes = []
        self.now_ms = 1000
        self.room = True
        self.sent = []
        for index in (0x60FF, 0x68FF, 0x6040, 0x6840):
            self.objects.tie(index, 0, write=self.taker(index))
        for index in (0x606C, 0x686C, 0x6041, 0x6841):
            self.values[index] = 0
            self.objects.tie(index, 0, read=self.giver(index))
        self.objects.tie(0x3001, 0, read=lambda: self.presence)
        self.rpdo = Rpdo(0, self.objects, lambda: self.now_ms, self.on_change)
        self.tpdo = Tpdo(0, self.objects, self.send, self.on_change)

    def taker(self, index):
        def take(value):
            self.values[index] = value

        return take

    def giver(self, index):
        return lambda: self.values[index]

    def on_change(self, sub):
        self.changes.append(sub)

    def send(self, can_id, data):
        if self.room:
            self.sent.append((can_id, data))
        return self.room

    def take(self):
        sent, self.sent = self.sent, []
        return sent

    def write(self, index, sub, number):
        """Write as an SDO client does; the code of the refusal, None if there was none."""
        entry = find(index, sub)
        return code_of(self.objects.write, entry, number.to_bytes(entry.size, "little"))

    def remap(self, parameters, mapping, can_id, *items):
        """The standard's procedure."""
        assert self.write(parameters, 1, 1 << 31 | can_id) is None
        assert self.write(mapping, 0, 0) is None
        for sub, item in enumerate(items):
            assert self.write(mapping, sub + 1, item) is None
        assert self.write(mapping, 0, len(items)) is None
        no_remote = NO_REMOTE if parameters >= 0x1800 else 0
        assert self.write(parameters, 1, no_remote | can_id) is None


def test_default_identifiers_follow_the_node_id():
    bench = Bench()
    assert bench.rpdo.can_id == 0x205
    assert bench.tpdo.can_id == 0x185


def test_synchronous_rpdo_takes_the_last_frame_at_sync():
    bench = Bench()
    assert bench.rpdo.on_frame(b"\x01\0\0\0\x02\0\0\0")
    assert bench.rpdo.on_frame(b"\xff\xff\xff\xff\x03\0\0\0")
    assert 0x60FF not in bench.values
    bench.rpdo.on_sync()
    assert (bench.values[0x60FF], bench.values[0x68FF]) == (-1, 3)
    bench.values.clear()
    bench.rpdo.on_sync()
    assert bench.values == {}


def test_event_driven_rpdo_takes_over_at_once():
    bench = Bench()
    assert bench.write(0x1400, 2, 255) is None
    bench.rpdo.on_frame(b"\x01\0\0\0\x02\0\0\0")
    assert bench.values[0x60FF] == 1


def test_frame_that_is_too_short_is_not_taken_and_one_too_long_is():
    bench = Bench()
    assert not bench.rpdo.on_frame(bytes(7))
    bench.remap(0x1400, 0x1600, 0x205, 0x60FF0020)
    assert bench.rpdo.on_frame(bytes(8))


def test_frame_that_is_too_short_is_noted_until_one_is_long_enough():
    bench = Bench()
    assert not bench.rpdo.short
    for length in (7, 0):
        bench.rpdo.on_frame(bytes(length))
    assert bench.rpdo.short
    assert bench.rpdo.take_short()
    assert not bench.rpdo.take_short()
    bench.rpdo.on_frame(bytes(8))
    assert not bench.rpdo.short
    bench.rpdo.on_frame(bytes(7))
    bench.rpdo.start()
    assert not bench.rpdo.short
    assert not bench.rpdo.take_short()


def test_rpdo_takes_its_part_of_a_neighbours_frame():
    bench = Bench()
    bench.remap(0x1400, 0x1600, 0x186, 0x00070020, 0x68FF0020)
    assert bench.rpdo.can_id == 0x186
    bench.rpdo.on_frame(b"\x01\0\0\0\x02\0\0\0")
    bench.rpdo.on_sync()
    assert bench.values[0x68FF] == 2
    assert 0x60FF not in bench.values


def test_rpdo_passes_over_dummies_of_every_length():
    for dummy, bits in ((2, 8), (3, 16), (4, 32), (5, 8), (6, 16), (7, 32)):
        bench = Bench()
        bench.remap(0x1400, 0x1600, 0x186, dummy << 16 | bits, 0x68FF0020)
        assert bench.rpdo.on_frame(bytes(bits // 8) + b"\x02\0\0\0")
        bench.rpdo.on_sync()
        assert bench.values[0x68FF] == 2
        assert 0x60FF not in bench.values


def test_tpdo_at_every_third_sync():
    bench = Bench()
    assert bench.write(0x1800, 2, 3) is None
    bench.values[0x606C] = 5
    for _ in range(2):
        bench.tpdo.on_sync()
    assert bench.take() == []
    bench.tpdo.on_sync()
    assert bench.take() == [(0x185, b"\x05\0\0\0\0\0\0\0")]


def test_acyclic_tpdo_at_sync_only_when_something_has_changed():
    bench = Bench()
    assert bench.write(0x1800, 2, 0) is None
    bench.tpdo.on_sync()
    bench.tpdo.on_sync()
    assert len(bench.take()) == 1
    bench.values[0x606C] = 1
    bench.tpdo.on_sync()
    assert len(bench.take()) == 1


def test_acyclic_tpdo_that_was_refused_gives_way_to_the_next_sync():
    bench = Bench()
    assert bench.write(0x1800, 2, 0) is None
    bench.tpdo.on_sync()
    bench.take()
    bench.room = False
    for value in (1, 2):
        bench.values[0x606C] = value
        bench.tpdo.on_sync()
    bench.room = True
    bench.tpdo.retry()
    assert bench.take() == [(0x185, b"\x02\0\0\0\0\0\0\0")]
    bench.room = False
    bench.values[0x606C] = 3
    bench.tpdo.on_sync()
    # The last sent values are true again: there is no change left to be sent.
    bench.values[0x606C] = 2
    bench.tpdo.on_sync()
    bench.room = True
    assert bench.tpdo.retry()
    assert bench.take() == []


def test_periodic_tpdo_that_was_refused_is_not_repeated():
    bench = Bench()
    bench.room = False
    assert bench.tpdo.on_sync()
    bench.room = True
    assert bench.tpdo.retry()
    assert bench.take() == []


def sent_at(bench, times, step=None):
    """The instants at which an event-driven TPDO is sent when polled every millisecond."""
    instants = []
    for now_ms in times:
        if step and now_ms % step == 0:
            bench.values[0x606C] += 1
        bench.tpdo.poll(now_ms & 0x3FFFFFFF)
        if bench.take():
            instants.append(now_ms)
    return instants


def test_event_timer_sends_again_across_the_wrap_of_the_clock():
    bench = Bench()
    assert bench.write(0x1800, 2, 255) is None
    assert bench.write(0x1800, 5, 20) is None
    start = (1 << 30) - 30
    assert sent_at(bench, range(start, start + 65)) == [start, start + 20, start + 40, start + 60]


def test_inhibit_time_keeps_changes_apart():
    bench = Bench()
    assert bench.write(0x1800, 1, 1 << 31 | 0x185) is None
    assert bench.write(0x1800, 3, 95) is None
    assert bench.write(0x1800, 2, 255) is None
    assert bench.write(0x1800, 1, NO_REMOTE | 0x185) is None
    assert sent_at(bench, range(50), step=2) == [0, 10, 20, 30, 40]


def test_tpdo_tells_when_it_is_to_be_polled_again():
    bench = Bench()
    # Speeds may change at any time, presence and statuswords are announced.
    assert bench.tpdo.poll(0) == ticks.RETRY_MS
    bench.remap(0x1800, 0x1A00, 0x185, 0x30010008, 0x60410010, 0x68410010)
    assert bench.tpdo.poll(0) == ticks.IDLE_MS
    assert bench.write(0x1800, 5, 20) is None
    assert bench.tpdo.poll(7) == 20
    assert bench.tpdo.poll(10) == 17
    bench.presence = 1
    bench.room = False
    assert bench.tpdo.poll(11) == ticks.RETRY_MS


def test_change_is_sent_when_there_is_room_again():
    bench = Bench()
    assert bench.write(0x1800, 2, 255) is None
    bench.room = False
    bench.tpdo.poll(0)
    bench.room = True
    bench.tpdo.poll(1)
    assert len(bench.take()) == 1


def test_tpdo_is_remapped_and_tells_of_its_identifier():
    bench = Bench()
    bench.values[0x6041] = 0x0250
    bench.presence = 0x1F
    bench.remap(0x1800, 0x1A00, 0x195, 0x30010008, 0x60410010)
    assert bench.changes == [1, 1]
    bench.tpdo.on_sync()
    assert bench.take() == [(0x195, b"\x1f\x50\x02")]


def test_a_valid_pdo_refuses_to_be_changed():
    bench = Bench()
    assert bench.write(0x1A00, 0, 0) == sdo.WRONG_STATE
    assert bench.write(0x1A00, 1, 0x30010008) == sdo.WRONG_STATE
    assert bench.write(0x1800, 3, 10) == sdo.WRONG_STATE
    assert bench.write(0x1800, 1, 0x196) == sdo.WRONG_STATE
    assert bench.objects.number(0x1A00, 0) == 2
    assert bench.objects.number(0x1A00, 1) == 0x606C0020
    assert bench.objects.number(0x1800, 1) == NO_REMOTE | 0x185


def test_entries_are_refused_while_they_are_counted():
    bench = Bench()
    assert bench.write(0x1800, 1, 1 << 31 | 0x185) is None
    assert bench.write(0x1A00, 1, 0x30010008) == sdo.WRONG_STATE


def test_mapping_is_refused_with_the_right_code():
    bench = Bench()
    for parameters, mapping in ((0x1800, 0x1A00), (0x1400, 0x1600)):
        assert bench.write(parameters, 1, 1 << 31 | 0x185) is None
        assert bench.write(mapping, 0, 0) is None
    refusals = (
        (0x1A00, 0x70000008, sdo.NO_SUCH_OBJECT),
        (0x1A00, 0x10180908, sdo.NO_SUCH_SUB_INDEX),
        (0x1A00, 0x30000010, sdo.NOT_MAPPABLE),
        (0x1A00, 0x60FF0020, sdo.NOT_MAPPABLE),
        (0x1A00, 0x606C0010, sdo.NOT_MAPPABLE),
        (0x1A00, 0x00070020, sdo.NOT_MAPPABLE),
        (0x1600, 0x606C0020, sdo.NOT_MAPPABLE),
        (0x1600, 0x00070010, sdo.NOT_MAPPABLE),
    )
    for mapping, item, code in refusals:
        refused = bench.write(mapping, 1, item)
        assert refused == code or (item == 0x00070020 and refused == sdo.NO_SUCH_OBJECT), item
    for sub in (1, 2, 3):
        assert bench.write(0x1A00, sub, 0x606C0020) is None
    assert bench.write(0x1A00, 0, 3) == sdo.PDO_TOO_LONG
    assert bench.write(0x1A00, 0, 9) == sdo.TOO_HIGH
    assert bench.write(0x1A00, 0, 2) is None


def test_entry_is_emptied_as_it_was_by_default_and_then_carries_nothing():
    for parameters, mapping in ((0x1800, 0x1A00), (0x1400, 0x1600)):
        bench = Bench()
        assert bench.write(parameters, 1, 1 << 31 | 0x185) is None
        assert bench.write(mapping, 0, 0) is None
        for sub in (2, 3):
            assert bench.write(mapping, sub, 0) is None
        assert bench.write(mapping, 0, 2) == sdo.NO_SUCH_OBJECT
        assert bench.write(mapping, 0, 1) is None


def test_parameters_are_refused_with_the_right_code():
    bench = Bench()
    assert bench.write(0x1800, 1, 1 << 31 | 0x185) is None
    for can_id in (0x000, 0x07F, 0x180, 0x585, 0x605, 0x705, 0x7E5, 1 << 29 | 0x185, 0x985):
        assert bench.write(0x1800, 1, NO_REMOTE | can_id) == sdo.INVALID_VALUE, can_id
    for transmission_type in (241, 252, 253):
        assert bench.write(0x1800, 2, transmission_type) == sdo.INVALID_VALUE
    assert bench.objects.number(0x1800, 2) == 1


def test_tpdo_answers_no_remote_request_and_must_say_so():
    bench = Bench()
    assert bench.objects.number(0x1800, 1) == NO_REMOTE | 0x185
    assert bench.objects.number(0x1802, 1) == NO_REMOTE | 0x385
    assert bench.write(0x1800, 1, 1 << 31 | 0x185) is None
    assert bench.write(0x1800, 1, 0x185) == sdo.INVALID_VALUE
    assert bench.tpdo.can_id is None
    assert bench.write(0x1800, 1, NO_REMOTE | 0x185) is None
    assert bench.tpdo.can_id == 0x185


def test_remote_bit_of_an_rpdo_means_nothing():
    bench = Bench()
    for flag in (0, NO_REMOTE):
        assert bench.write(0x1400, 1, flag | 0x205) is None
        assert bench.rpdo.can_id == 0x205


def test_identifiers_of_29_bits_are_refused_even_for_a_pdo_that_is_off():
    bench = Bench()
    for parameters in (0x1400, 0x1800):
        for invalid in (0, 1 << 31):
            cob_id = invalid | NO_REMOTE | 1 << 29 | 0x285
            assert bench.write(parameters, 1, cob_id) == sdo.INVALID_VALUE
