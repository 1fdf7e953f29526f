"""The two ways of a gateway, without buses."""

from mdms_sim.nodes.gateway import GatewayDirection, check_tables

TABLE = {0x181: 0x1FE, 0x182: 0x1FD, 0x183: 0x1FC}


def refuses(there, back):
    try:
        check_tables(there, back)
    except ValueError:
        return True
    return False


class Bus:
    """Takes so many frames."""

    def __init__(self, room=100):
        self.room = room
        self.taken = []

    def send(self, can_id, data):
        if not self.room:
            return None
        self.room -= 1
        self.taken.append((can_id, data))
        return 0


def test_listed_frame_leaves_under_its_other_identifier():
    way, bus = GatewayDirection(TABLE), Bus()
    way.take(0x182, b"\x01\x02", 0)
    way.drain(bus.send, 0)
    assert bus.taken == [(0x1FD, b"\x01\x02")]
    assert (way.forwarded, way.dropped, way.waiting) == (1, 0, 0)


def test_frame_that_is_not_listed_goes_nowhere():
    way, bus = GatewayDirection(TABLE), Bus()
    for can_id in (0x080, 0x1FE, 0x184, 0x700):
        way.take(can_id, b"\x01", 0)
    way.drain(bus.send, 0)
    assert bus.taken == []
    assert way.dropped == 0


def test_frames_leave_in_the_order_in_which_they_came():
    way, bus = GatewayDirection(TABLE), Bus()
    for can_id in (0x183, 0x181, 0x182):
        way.take(can_id, bytes([can_id & 0xFF]), 0)
    way.drain(bus.send, 0)
    assert [data[0] for _, data in bus.taken] == [0x83, 0x81, 0x82]


def test_newer_frame_takes_the_place_of_the_one_that_waits():
    way, bus = GatewayDirection(TABLE), Bus()
    way.take(0x181, b"old data", 0)
    way.take(0x182, b"", 1)
    way.take(0x181, b"new", 2)
    way.drain(bus.send, 3)
    assert bus.taken == [(0x1FE, b"new"), (0x1FD, b"")]
    assert (way.forwarded, way.replaced) == (2, 1)


def test_full_bus_gets_the_rest_when_it_has_room():
    way, bus = GatewayDirection(TABLE), Bus(room=1)
    way.take(0x181, b"a", 0)
    way.take(0x182, b"b", 0)
    way.drain(bus.send, 1)
    assert (len(bus.taken), way.waiting) == (1, 1)
    bus.room = 1
    way.drain(bus.send, 5)
    assert bus.taken == [(0x1FE, b"a"), (0x1FD, b"b")]


def test_frame_that_has_waited_for_too_long_is_dropped_and_counted():
    way, bus = GatewayDirection(TABLE), Bus(room=0)
    way.take(0x181, b"a", 0)
    way.take(0x182, b"b", 5)
    way.drain(bus.send, 10)
    bus.room = 5
    way.drain(bus.send, 11)
    assert bus.taken == [(0x1FD, b"b")]
    assert (way.forwarded, way.overdue, way.dropped, way.waiting) == (1, 1, 1, 0)


def test_flood_into_a_dead_bus_stays_within_the_table():
    way, bus = GatewayDirection(TABLE), Bus(room=0)
    for number in range(1000):
        way.take(0x181 + number % 3, bytes([number & 0xFF]), number // 100)
        way.drain(bus.send, number // 100)
    assert way.waiting == 3
    assert way.forwarded + way.dropped + way.waiting == 1000


def test_time_may_wrap_while_a_frame_waits():
    way, bus = GatewayDirection(TABLE), Bus()
    way.take(0x181, b"a", (1 << 30) - 2)
    way.drain(bus.send, 3)
    assert bus.taken == [(0x1FE, b"a")]


def test_garbage_of_more_bytes_than_a_frame_has_is_left_out():
    way, bus = GatewayDirection(TABLE), Bus()
    way.take(0x181, bytes(9), 0)
    way.drain(bus.send, 0)
    assert bus.taken == []


def test_way_without_a_table_forwards_nothing():
    way, bus = GatewayDirection({}), Bus()
    way.take(0x181, b"", 0)
    way.drain(bus.send, 0)
    assert bus.taken == []


def test_two_ways_do_not_mix():
    there, back = GatewayDirection({0x181: 0x1FE}), GatewayDirection({0x182: 0x1FD})
    bus = Bus()
    there.take(0x181, b"a", 0)
    back.drain(bus.send, 0)
    assert bus.taken == []
    there.drain(bus.send, 0)
    assert bus.taken == [(0x1FE, b"a")]


def test_tables_by_which_a_frame_would_come_back_are_refused():
    assert refuses({0x181: 0x182}, {0x182: 0x181})
    assert refuses({0x181: 0x1FE}, {0x1FE: 0x1FD})


def test_tables_that_make_one_identifier_of_two_are_refused():
    assert refuses({0x181: 0x1FE, 0x182: 0x1FE}, {})
