"""The heartbeat consumer by itself: its watched nodes, and the time until one counts as silent."""

from refusal import code_of

from mdms_cell import ticks
from mdms_cell.canopen.nmt import Consumer
from mdms_cell.canopen.objects import Objects, find
from mdms_protocol.codecs import sdo

TIMES = 0x1016
HOST = 127
NEIGHBOUR = 6
OPERATIONAL = b"\x05"


class Bench:
    """A consumer, and the time of the heartbeats that it receives."""

    def __init__(self):
        self.objects = Objects()
        self.now_ms = 0
        self.changes = 0
        self.consumer = Consumer(self.objects, lambda: self.now_ms, self.count)

    def count(self):
        self.changes += 1

    def watch(self, sub, node_id, limit_ms):
        value = (node_id << 16 | limit_ms).to_bytes(4, "little")
        self.objects.write(find(TIMES, sub), value)

    def refused(self, sub, node_id, limit_ms):
        return code_of(self.watch, sub, node_id, limit_ms)

    def hear(self, node_id, now_ms, data=OPERATIONAL):
        self.now_ms = now_ms
        return dict(self.consumer.receivers())[0x700 + node_id](data)


def watching():
    bench = Bench()
    bench.watch(1, HOST, 200)
    bench.watch(3, NEIGHBOUR, 300)
    return bench


def test_node_is_lost_exactly_when_its_time_is_over():
    bench = watching()
    assert bench.hear(HOST, 1000)
    assert not bench.consumer.poll(1199)
    assert bench.consumer.poll(1200)
    assert bench.consumer.lost == {HOST}


def test_loss_is_told_once_until_the_node_is_heard_again():
    bench = watching()
    bench.hear(HOST, 0)
    assert bench.consumer.poll(200)
    assert not bench.consumer.poll(500)
    assert bench.consumer.lost == {HOST}
    assert bench.hear(HOST, 600)
    assert bench.consumer.lost == set()
    assert bench.consumer.poll(800)


def test_every_node_has_its_own_time():
    bench = watching()
    bench.hear(HOST, 0)
    bench.hear(NEIGHBOUR, 0)
    assert bench.consumer.poll(250)
    assert not bench.consumer.poll(299)
    assert bench.consumer.poll(300)
    assert bench.consumer.lost == {HOST, NEIGHBOUR}


def test_tells_when_the_next_could_be_lost():
    bench = watching()
    assert bench.consumer.wait_ms(0) == ticks.IDLE_MS
    bench.hear(NEIGHBOUR, 0)
    assert bench.consumer.wait_ms(10) == 290
    bench.hear(HOST, 20)
    assert bench.consumer.wait_ms(30) == 190


def test_silence_is_told_over_the_wrap_of_the_clock():
    bench = watching()
    bench.hear(HOST, (1 << 30) - 100)
    assert not bench.consumer.poll(99)
    assert bench.consumer.poll(100)


def test_a_frame_that_is_no_heartbeat_does_not_count_as_one():
    bench = watching()
    bench.hear(HOST, 0)
    for data in (b"", b"\x03", b"\x05\x00"):
        assert not bench.hear(HOST, 150, data)
    assert bench.consumer.poll(200)


def test_only_nodes_that_exist_are_watched_and_only_for_a_time():
    bench = Bench()
    for sub, node_id, limit_ms in ((1, 0, 100), (2, 127, 100), (3, 127, 0), (4, 1, 100)):
        bench.watch(sub, node_id, limit_ms)
    assert sorted(can_id for can_id, _ in bench.consumer.receivers()) == [0x701, 0x77F]
    assert bench.changes == 4
    assert bench.refused(1, 128, 100) == sdo.TOO_HIGH


def test_node_that_is_watched_already_is_refused():
    bench = watching()
    for sub in (2, 4):
        assert bench.refused(sub, HOST, 100) == sdo.INCOMPATIBLE
    assert bench.refused(1, HOST, 100) is None
    assert bench.refused(2, HOST, 0) is None
    assert bench.refused(2, 0, 100) is None
    assert bench.refused(4, 0, 100) is None


def test_entry_without_a_time_keeps_its_node_from_no_other_entry():
    bench = watching()
    bench.watch(2, HOST, 0)
    assert bench.refused(1, HOST, 100) is None
    bench.watch(1, HOST, 0)
    assert bench.refused(4, HOST, 300) is None
    assert bench.refused(1, HOST, 100) == sdo.INCOMPATIBLE
    bench.hear(HOST, 0)
    assert not bench.consumer.poll(299)
    assert bench.consumer.poll(300)


def test_write_to_one_entry_leaves_the_state_of_all_other_nodes():
    bench = watching()
    bench.hear(HOST, 0)
    bench.hear(NEIGHBOUR, 100)
    assert bench.consumer.poll(200)
    for sub, node_id, limit_ms in ((2, 44, 75), (2, 0, 0), (4, HOST, 0)):
        bench.watch(sub, node_id, limit_ms)
        assert bench.consumer.lost == {HOST}
    assert not bench.consumer.poll(399)
    assert bench.consumer.poll(400)
    assert bench.consumer.lost == {HOST, NEIGHBOUR}


def test_entry_of_no_node_takes_the_watch_from_none():
    for node_id in (1, HOST):
        bench = Bench()
        bench.watch(2, node_id, 100)
        assert bench.hear(node_id, 0)
        bench.watch(4, NEIGHBOUR, 300)
        assert bench.consumer.poll(100)
        assert bench.consumer.lost == {node_id}


def test_entry_that_is_written_is_watched_from_the_next_heartbeat_on():
    bench = watching()
    bench.hear(HOST, 0)
    assert bench.consumer.poll(200)
    bench.watch(1, HOST, 50)
    assert bench.consumer.lost == set()
    assert not bench.consumer.poll(1000)
    bench.hear(HOST, 1000)
    assert bench.consumer.poll(1050)


def test_node_of_an_entry_that_names_another_is_not_watched_any_more():
    bench = watching()
    bench.hear(HOST, 0)
    bench.watch(1, 44, 50)
    assert sorted(can_id for can_id, _ in bench.consumer.receivers()) == [0x706, 0x72C]
    assert not bench.consumer.poll(1000)


def test_nodes_may_change_places():
    bench = watching()
    bench.hear(HOST, 0)
    bench.watch(1, 0, 0)
    bench.watch(3, HOST, 300)
    bench.watch(1, NEIGHBOUR, 200)
    assert sorted(can_id for can_id, _ in bench.consumer.receivers()) == [0x706, 0x77F]
    bench.hear(NEIGHBOUR, 0)
    assert bench.consumer.poll(200)
