"""Network management (CiA 301, 7.2.8): commands, states and their frames."""

from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame

# Commands
START = 0x01
STOP = 0x02
ENTER_PRE_OPERATIONAL = 0x80
RESET_NODE = 0x81
RESET_COMMUNICATION = 0x82

# States, as heartbeats carry them
INITIALISING = 0x00
STOPPED = 0x04
OPERATIONAL = 0x05
PRE_OPERATIONAL = 0x7F

#: The state that a command leads to.
TRANSITIONS = {
    START: OPERATIONAL,
    STOP: STOPPED,
    ENTER_PRE_OPERATIONAL: PRE_OPERATIONAL,
    RESET_NODE: INITIALISING,
    RESET_COMMUNICATION: INITIALISING,
}
STATES = (INITIALISING, STOPPED, OPERATIONAL, PRE_OPERATIONAL)

ALL_NODES = 0


def command(code: int, node_id: int = ALL_NODES) -> Frame:
    """The frame that commands one node, or all of them.

    Raises ValueError for an unknown command or node id.
    """
    if code not in TRANSITIONS:
        raise ValueError("NMT command %r is none of %r" % (code, sorted(TRANSITIONS)))
    if not ALL_NODES <= node_id <= cob.NODE_MAX:
        raise ValueError("node id %r is not in 0..127" % (node_id,))
    return Frame(cob.NMT, bytes((code, node_id)))


def heartbeat(node_id: int, state: int) -> Frame:
    """The heartbeat frame of a node; state INITIALISING makes it the boot-up message."""
    return Frame(cob.HEARTBEAT_BASE + node_id, bytes((state,)))


def decode_heartbeat(data: bytes) -> int | None:
    """The state that a heartbeat reports, None if it is no heartbeat."""
    if len(data) != 1 or data[0] not in STATES:
        return None
    return data[0]
