"""18 cells on real MicroPython, commissioned by the unmodified `canopen` library.

The cells are processes in lock step with the virtual bus; the library is a client of the served bus
in real time. A blank cell has nothing but its serial number.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import chain, repeat
from pathlib import Path

import canopen
from canopen.objectdictionary import import_od
from tests.system.links.serving import serving

from mdms_protocol.codecs import cob
from mdms_sim.nodes.micropython_bank import MicropythonBank

EDS = str(Path(__file__).parents[3] / "protocol" / "mdms-cell.eds")
CELLS = 18
NODE_IDS = range(21, 21 + CELLS)
PATIENCE_S = 60
ANSWER_S = 2
#: `fast_scan` waits this long for each answer that does not come: short at first, for there are
#: some fifty for each cell; longer when a busy machine was too slow.
SCAN_TIMEOUTS_S = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)


@contextmanager
def canopen_network(channel: str, blank: int) -> Iterator[canopen.Network]:
    """A `canopen` network of the cells; the first of them begin blank, the others have node ids.

    `scanned` has the identities that `fast_scan` found. MicropythonMissing without the unix port.
    """
    bank = MicropythonBank([cob.NODE_NONE] * blank + list(NODE_IDS[blank:]))
    with serving(bank, channel):
        network = canopen.Network()
        try:
            network.connect(interface="mdms", channel=channel)
            network.scanned = []
            for node_id in NODE_IDS:
                if len(network.scanned) < blank:
                    commission(network, node_id)
                node = network.add_node(node_id, import_od(EDS, node_id))
                node.sdo.RESPONSE_TIMEOUT = ANSWER_S
            wait_until(lambda: all(node.nmt.timestamp is not None for node in network.values()))
            yield network
        finally:
            network.disconnect()


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait, with patience."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, condition
        time.sleep(0.01)


def commission(network: canopen.Network, node_id: int) -> None:
    """Find a blank cell and give it a node id."""
    network.scanned.append(scan(network))
    network.lss.RESPONSE_TIMEOUT = ANSWER_S
    network.lss.configure_node_id(node_id)
    network.lss.store_configuration()
    network.lss.send_switch_state_global(network.lss.WAITING_STATE)


def scan(network: canopen.Network) -> list[int]:
    """The identity of a cell; on a busy machine answers are late, and a late one fails a scan."""
    deadline_s = time.monotonic() + PATIENCE_S
    patience_s = chain(SCAN_TIMEOUTS_S, repeat(SCAN_TIMEOUTS_S[-1]))
    while time.monotonic() < deadline_s:
        network.lss.RESPONSE_TIMEOUT = next(patience_s)
        found, identity = network.lss.fast_scan()
        if found:
            return identity
    raise AssertionError("no blank cell answers")
