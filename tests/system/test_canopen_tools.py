"""The unmodified `canopen` library commissions 18 cells that run on real MicroPython.

The cells are processes in lock step with the virtual bus; the library is a client of the served
bus in real time. The cells begin blank: all they have is a serial number.
"""

import time
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import import_od
from tests.micropython_builds import skipping_without_micropython
from tests.system.serving import serving

from mdms_protocol import cia402, cob
from mdms_sim.nodes.micropython_bank import MicropythonBank

#: One array is commissioned for all.
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("canopen tools")]

EDS = str(Path(__file__).parents[2] / "protocol" / "mdms-cell.eds")
CELLS = 18
NODE_IDS = range(21, 21 + CELLS)
PATIENCE_S = 10
#: `fast_scan` waits this long for each answer that does not come: short at first, for there are
#: over a thousand; longer when a busy machine was too slow.
SCAN_TIMEOUTS_S = (0.05, 0.1, 0.2, 0.4, 0.8)


def wait_until(condition):
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, condition
        time.sleep(0.01)


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    """A `canopen` network of 18 cells, to which the library has just given node ids by LSS."""
    channel = str(tmp_path_factory.mktemp("bus") / "bus.sock")
    with skipping_without_micropython():
        bank = MicropythonBank([cob.NODE_NONE] * CELLS)
    with serving(bank, channel):
        network = canopen.Network()
        try:
            network.connect(interface="mdms", channel=channel)
            commission(network)
            yield network
        finally:
            network.disconnect()


def scan(network):
    """The identity of a cell; an answer that is late on a busy machine fails a scan."""
    for timeout_s in SCAN_TIMEOUTS_S:
        network.lss.RESPONSE_TIMEOUT = timeout_s
        found, identity = network.lss.fast_scan()
        if found:
            return identity
    raise AssertionError("no blank cell answers")


def commission(network):
    network.scanned = []
    for node_id in NODE_IDS:
        network.scanned.append(scan(network))
        network.lss.RESPONSE_TIMEOUT = 1
        network.lss.configure_node_id(node_id)
        network.lss.store_configuration()
        network.lss.send_switch_state_global(network.lss.WAITING_STATE)
        node = network.add_node(node_id, import_od(EDS, node_id))
        node.sdo.RESPONSE_TIMEOUT = 2
        node.nmt.wait_for_heartbeat(PATIENCE_S)


def test_every_blank_cell_was_found_once_by_fast_scan(network):
    serials = [identity[3] for identity in network.scanned]
    assert sorted(serials) == list(range(1, CELLS + 1))
    assert network.lss.fast_scan() == (False, None)


def test_identities_are_those_that_were_scanned(network):
    for node_id, identity in zip(NODE_IDS, network.scanned, strict=True):
        record = network[node_id].sdo[0x1018]
        assert [record[sub].raw for sub in (1, 2, 3, 4)] == identity


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
    node = network[NODE_IDS[2]]
    node.nmt.send_command(0x81)
    node.nmt.wait_for_bootup(PATIENCE_S)
    assert node.sdo[0x1018][4].raw == network.scanned[2][3]


def test_remapped_pdo_carries_the_new_object(network):
    node = network[NODE_IDS[3]]
    node.tpdo.read()
    mapping = node.tpdo[3]
    mapping.clear()
    mapping.add_variable(0x3001)
    mapping.add_variable(0x6063)
    mapping.cob_id = 0x380 + NODE_IDS[3]
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
            for word in (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION):
                node.sdo[index].raw = word


def test_setpoints_and_states_stream_by_sync_and_a_stale_setpoint_is_an_emergency(network):
    nodes = [network[node_id] for node_id in NODE_IDS]
    for node in nodes:
        node.rpdo.read(from_od=True)
        node.tpdo.read(from_od=True)
        node.emcy.reset()
    enable(network, NODE_IDS)
    for node in nodes:
        node.rpdo[1][0].raw = 50_000
        node.rpdo[1][1].raw = -50_000

    def turning():
        for node in nodes:
            node.rpdo[1].transmit()
        network.sync.transmit()
        time.sleep(0.02)
        return all(node.tpdo[1][0].raw > 20_000 and node.tpdo[1][1].raw < -20_000 for node in nodes)

    wait_until(turning)
    wait_until(lambda: all(node.emcy.log for node in nodes))
    assert {node.emcy.log[0].code for node in nodes} == {0x8250}
    assert all(cia402.state(node.sdo[0x6041].raw) == cia402.FAULT for node in nodes)
    assert all(node.sdo[0x603F].raw == 0x8250 for node in nodes)
    network.nmt.send_command(0x81)
    wait_until(lambda: nodes[-1].nmt.state == "PRE-OPERATIONAL")
