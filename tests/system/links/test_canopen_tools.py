"""The unmodified `canopen` library commissions 18 cells that run on real MicroPython.

Two of them begin blank; `python -m tests.soak.fast_scan` has the library scan for all.
"""

import time

import pytest
from tests.micropython_builds import skipping_without_micropython
from tests.system.links.canopen_network import NODE_IDS, PATIENCE_S, canopen_network, wait_until

from mdms_protocol.codecs import cia402

#: Setpoints that come 0.5 s late are stale.
pytestmark = [pytest.mark.slow, pytest.mark.real_time]

BLANK = 2
CHANCES = 10
SILENCE_S = 0.5


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    """A `canopen` network of 18 cells; the library has just given node ids to the blank ones."""
    channel = str(tmp_path_factory.mktemp("bus") / "bus.sock")
    with skipping_without_micropython(), canopen_network(channel, BLANK) as network:
        yield network


def test_every_blank_cell_was_found_once_by_fast_scan(network):
    serials = [identity[3] for identity in network.scanned]
    assert sorted(serials) == list(range(1, BLANK + 1))
    network.lss.RESPONSE_TIMEOUT = SILENCE_S
    assert network.lss.fast_scan() == (False, None)


def test_identities_are_those_that_were_scanned(network):
    for node_id, identity in zip(NODE_IDS[:BLANK], network.scanned, strict=True):
        record = network[node_id].sdo[0x1018]
        assert [record[sub].raw for sub in (1, 2, 3, 4)] == identity


def test_every_cell_answers_with_a_serial_number_of_its_own(network):
    serials = {network[node_id].sdo[0x1018][4].raw for node_id in NODE_IDS}
    assert len(serials) == len(NODE_IDS)


def test_nmt_commands_reach_one_cell_and_all(network):
    first, second = network[NODE_IDS[0]], network[NODE_IDS[1]]
    first.nmt.state = "OPERATIONAL"
    first.nmt.wait_for_heartbeat(PATIENCE_S)
    wait_until(lambda: first.nmt.state == "OPERATIONAL")
    assert second.nmt.state == "PRE-OPERATIONAL"
    network.nmt.send_command(0x02)
    wait_until(lambda: all(network[node_id].nmt.state == "STOPPED" for node_id in NODE_IDS))
    network.nmt.send_command(0x80)
    wait_until(lambda: all(network[node_id].nmt.state == "PRE-OPERATIONAL" for node_id in NODE_IDS))


def test_node_id_outlives_a_reset(network):
    node = network[NODE_IDS[1]]
    node.nmt.send_command(0x81)
    node.nmt.wait_for_bootup(PATIENCE_S)
    assert node.sdo[0x1018][4].raw == network.scanned[1][3]


def test_remapped_pdo_carries_the_new_object(network):
    node = network[NODE_IDS[2]]
    node.tpdo.read()
    mapping = node.tpdo[3]
    mapping.clear()
    mapping.add_variable(0x3001)
    mapping.add_variable(0x6063)
    mapping.cob_id = 0x380 + NODE_IDS[2]
    mapping.trans_type = 255
    mapping.event_timer = 20
    mapping.enabled = True
    mapping.save()
    node.nmt.state = "OPERATIONAL"
    assert mapping.wait_for_reception(PATIENCE_S) is not None
    assert mapping[0].raw == node.sdo[0x3001].raw
    node.nmt.state = "PRE-OPERATIONAL"


def enable(network, node_ids):
    for node_id in node_ids:
        node = network[node_id]
        node.sdo[0x3000].raw = 500
        node.nmt.state = "OPERATIONAL"
        for index in (0x6040, 0x6840):
            for word in (
                cia402.FAULT_RESET,
                cia402.SHUTDOWN,
                cia402.SWITCH_ON,
                cia402.ENABLE_OPERATION,
            ):
                node.sdo[index].raw = word


def test_setpoints_and_states_stream_by_sync_and_a_stale_setpoint_is_an_emergency(network):
    nodes = [network[node_id] for node_id in NODE_IDS]
    for node in nodes:
        node.rpdo.read(from_od=True)
        node.tpdo.read(from_od=True)
        node.rpdo[1][0].raw = 50_000
        node.rpdo[1][1].raw = -50_000

    def turning():
        for node in nodes:
            node.rpdo[1].transmit()
        network.sync.transmit()
        time.sleep(0.02)
        return all(node.tpdo[1][0].raw > 20_000 and node.tpdo[1][1].raw < -20_000 for node in nodes)

    # A machine that pauses for 0.5 s has set them off before.
    for _ in range(CHANCES):
        for node in nodes:
            node.emcy.reset()
        enable(network, NODE_IDS)
        wait_until(lambda: turning() or any(node.emcy.log for node in nodes))
        if not any(node.emcy.log for node in nodes):
            break
    wait_until(lambda: all(node.emcy.log for node in nodes))
    assert {node.emcy.log[0].code for node in nodes} == {0x8250}
    # Wheels are brought to rest, and held for a while, before the drives are in 'fault'.
    wait_until(lambda: all(cia402.state(node.sdo[0x6041].raw) == cia402.FAULT for node in nodes))
    assert all(node.sdo[0x603F].raw == 0x8250 for node in nodes)
    network.nmt.send_command(0x81)
    wait_until(lambda: nodes[-1].nmt.state == "PRE-OPERATIONAL")
