import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.buses import (
    BusTraffic,
    address_cells,
    foreign_nodes,
    neighbours,
    plan_gateways,
    worst_bits,
)
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.wire import INTERFRAME_BITS, frame_bits

HALVES = [[1, 2, 5, 6], [3, 4, 7, 8]]  # 4 x 2 cells, a border down the middle


def test_without_lists_all_cells_are_on_one_bus_with_their_numbers_as_node_ids():
    addresses = address_cells(3)
    assert addresses.buses == (0, 0, 0)
    assert addresses.node_ids == (1, 2, 3)


def test_node_id_is_the_place_in_the_list_of_the_bus():
    addresses = address_cells(5, [[5, 1], [2, 4, 3]])
    assert addresses.buses == (0, 1, 1, 1, 0)
    assert addresses.node_ids == (2, 1, 3, 2, 1)
    assert addresses.bus_count == 2
    assert addresses.on_bus(1) == [2, 3, 4]


@pytest.mark.parametrize(
    ("number", "around"),
    [(1, [2, 5, 6]), (6, [1, 2, 3, 5, 7, 9, 10, 11]), (8, [3, 4, 7, 11, 12]), (12, [7, 8, 11])],
)
def test_neighbours_are_the_cells_around(number, around):
    assert list(neighbours(number, 4, 3)) == around


def test_cells_beyond_a_border_have_node_ids_from_the_highest_down():
    addresses = address_cells(8, HALVES)
    assert foreign_nodes(4, 2, addresses) == ({3: 126, 7: 125}, {2: 126, 6: 125})


def test_gateway_forwards_the_pdos_of_both_sides_of_a_border():
    (plan,) = plan_gateways(4, 2, address_cells(8, HALVES), [1, 3])
    assert plan.buses == (0, 1)
    # Cells 2 and 6 are nodes 2 and 4 of their bus; 3 and 7 are nodes 1 and 3 of theirs.
    assert plan.tables == (
        {0x182: 0x1FE, 0x382: 0x3FE, 0x184: 0x1FD, 0x384: 0x3FD},
        {0x181: 0x1FE, 0x381: 0x3FE, 0x183: 0x1FD, 0x383: 0x3FD},
    )


def test_nothing_to_forward_needs_no_gateway():
    assert plan_gateways(4, 2, address_cells(8, HALVES), []) == ()
    assert plan_gateways(4, 2, address_cells(8), [1]) == ()


def test_buses_that_touch_at_a_corner_alone_have_a_gateway_too():
    quarters = address_cells(16, [[1, 2, 5, 6], [3, 4, 7, 8], [9, 10, 13, 14], [11, 12, 15, 16]])
    plans = plan_gateways(4, 4, quarters, [1])
    assert [plan.buses for plan in plans] == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    # Around the last are 6, 7, 8, 10 and 14, around the first 3, 7, 9, 10 and 11.
    assert plans[2].tables == ({0x184: 0x1FE}, {0x181: 0x1FA})


def test_bus_without_node_ids_left_for_those_around_it_is_refused():
    # 122 cells of a row of 124 columns, with 124 around them.
    lists = [range(1, 123), range(123, 249)]
    with pytest.raises(ValueError, match="up to 122, which leaves 4 for the 124 cells"):
        plan_gateways(124, 2, address_cells(248, lists), [1])


@given(st.lists(st.integers(0, 3), min_size=12, max_size=12))
def test_every_neighbour_over_a_border_is_heard_once_and_nothing_comes_back(buses):
    names = sorted(set(buses))
    lists = [[n for n, bus in enumerate(buses, 1) if bus == name] for name in names]
    addresses = address_cells(12, lists)
    plans = plan_gateways(4, 3, addresses, [1])
    foreign = foreign_nodes(4, 3, addresses)
    arriving = [[] for _ in names]
    for plan in plans:
        for side, table in enumerate(plan.tables):
            arriving[plan.buses[1 - side]] += table.values()
    for bus in range(len(names)):
        own = {0x180 + addresses.node_ids[number - 1] for number in addresses.on_bus(bus)}
        assert sorted(arriving[bus]) == sorted(0x180 + node for node in foreign[bus].values())
        assert not own & {*arriving[bus]}
        for number in addresses.on_bus(bus):
            beyond = [
                each for each in neighbours(number, 4, 3) if each not in addresses.on_bus(bus)
            ]
            assert {*beyond} <= foreign[bus].keys()


def traffic(bitrate=1_000_000, sync_period_s=0.01):
    return BusTraffic(bitrate, sync_period_s, heartbeat_period_s=0.1, status_period_s=0.2)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_no_frame_is_longer_than_the_longest_of_its_size(can_id, data):
    assert frame_bits(Frame(can_id, data)) + INTERFRAME_BITS <= worst_bits(len(data))


@pytest.mark.parametrize(("size", "bits"), [(0, 55), (1, 65), (8, 135)])
def test_longest_frames_are_those_of_the_literature(size, bits):
    assert worst_bits(size) == bits


def test_load_is_the_sum_of_repeated_frames():
    # SYNC and the host's heartbeat; setpoints and speeds, state, and heartbeat of each cell.
    expected = 100 * 55 + 10 * 65 + 18 * (100 * 2 * 135 + 5 * 105 + 10 * 65)
    assert traffic().load(18) == pytest.approx(expected / 1e6)
    assert traffic(500_000).load(18) == pytest.approx(expected / 5e5)


@pytest.mark.parametrize("bitrate", [50_000, 125_000, 500_000, 1_000_000])
@pytest.mark.parametrize("sync_period_s", [0.005, 0.01, 0.02])
def test_most_cells_are_those_within_the_limit(bitrate, sync_period_s):
    bus = traffic(bitrate, sync_period_s)
    most = bus.most_cells()
    assert bus.load(most + 1) > 0.8
    assert most == 0 or bus.load(most) <= 0.8


def test_forwarded_frames_come_at_every_sync():
    bus = traffic()
    assert bus.load(18, 12) - bus.load(18) == pytest.approx(12 * 100 * 135 / 1e6)
