"""A gateway on two simulated buses, with somebody on each."""

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.exchange import Disturbance
from mdms_sim.kernel import Kernel
from mdms_sim.nodes.gateway import GatewayNode

MS = 1_000_000
TABLES = ({0x181: 0x1FE, 0x183: 0x1FD}, {0x182: 0x1FE})


class Ear:
    """Records the received frames and their times [us]."""

    def __init__(self):
        self.heard = []

    def on_frame(self, frame, now_ns):
        self.heard.append((frame.can_id, frame.data, now_ns // 1000))


class Pair:
    """Two buses with a gateway between them, and two stations on each."""

    def __init__(self):
        self.kernel = Kernel()
        self.buses = (Bus(self.kernel), Bus(self.kernel))
        self.gateway = GatewayNode(self.kernel, self.buses, TABLES)
        self.ears = [Ear(), Ear()]
        self.stations = [bus.attach(ear) for bus, ear in zip(self.buses, self.ears, strict=True)]
        for bus in self.buses:
            bus.attach(Ear(), ())

    def run(self, until_ms):
        self.kernel.run_until(until_ms * MS)


def test_frame_of_one_bus_is_heard_on_the_other_a_turn_later():
    pair = Pair()
    pair.stations[0].send(Frame(0x181, b"\x11" * 8))
    pair.run(1)
    (can_id, data, at_us), *more = pair.ears[1].heard
    assert (can_id, data, more) == (0x1FE, b"\x11" * 8, [])
    # Two frames of some 115 us, and the turn of its loop between them.
    assert 310 < at_us < 350


def test_ways_are_apart_and_nothing_comes_back():
    pair = Pair()
    pair.stations[0].send(Frame(0x181, b"a"))
    pair.stations[1].send(Frame(0x182, b"b"))
    for station in pair.stations:
        station.send(Frame(0x1FE, b"forged"))
        station.send(Frame(0x080, b""))
    pair.run(5)
    heard = [[each[:2] for each in ear.heard] for ear in pair.ears]
    assert heard == [[(0x1FE, b"b")], [(0x1FE, b"a")]]
    assert [bus.frames for bus in pair.buses] == [4, 4]


def test_crowded_bus_gets_the_newest_frames_and_the_others_are_counted():
    pair = Pair()

    def babble():
        if pair.stations[1].pending < 2:
            pair.stations[1].send(Frame(0x001, bytes(8)))
        pair.kernel.at(pair.kernel.now_ns + 50_000, 0, babble)

    def state(number):
        pair.stations[0].send(Frame(0x181, bytes([number])))
        pair.stations[0].send(Frame(0x183, bytes([number])))

    babble()
    for number in range(20):
        pair.kernel.at(number * 10 * MS, 0, lambda number=number: state(number))
    pair.run(200)
    there = pair.gateway.ways[0]
    assert pair.ears[1].heard == []
    # One of each identifier stands in a mailbox, which nobody takes back.
    assert there.forwarded == 2
    assert there.forwarded + there.dropped + there.waiting == 40


def test_gateway_comes_back_after_bus_off_with_fresh_frames_alone():
    pair = Pair()
    side = pair.gateway.controllers[1]
    pair.buses[1].disturb(lambda sender, frame: Disturbance(30) if sender is side else None)
    pair.stations[0].send(Frame(0x181, b"old"))
    pair.run(20)
    assert not side.live
    pair.buses[1].disturb(None)
    for at_ms in (50, 150):
        pair.kernel.at(
            at_ms * MS, 0, lambda at_ms=at_ms: pair.stations[0].send(Frame(0x183, bytes([at_ms])))
        )
    pair.run(200)
    assert [each[:2] for each in pair.ears[1].heard] == [(0x1FD, bytes([150]))]
    assert pair.gateway.ways[0].overdue == 1
