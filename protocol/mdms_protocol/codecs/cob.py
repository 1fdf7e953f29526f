"""Identifiers on the bus: the predefined connection set of CiA 301 and those of LSS (CiA 305).

The names ending in `_BASE` are the identifier of node 0; add the node id.
"""

NMT = 0x000
SYNC = 0x080
EMCY_BASE = 0x080
TIME = 0x100
TPDO_BASES = (0x180, 0x280, 0x380, 0x480)
RPDO_BASES = (0x200, 0x300, 0x400, 0x500)
SDO_RESPONSE_BASE = 0x580
SDO_REQUEST_BASE = 0x600
HEARTBEAT_BASE = 0x700
LSS_RESPONSE = 0x7E4
LSS_REQUEST = 0x7E5

#: Node ids that there may be; the last is the host's own, and no cell may get it.
NODE_MIN = 1
NODE_MAX = 127
HOST_NODE = 127
CELL_NODE_MAX = 126
#: TPDO 3 and 4: the belief of a cell, and the motion program that it hands on.
ESTIMATE_BASE = TPDO_BASES[2]
PROGRAM_BASE = TPDO_BASES[3]
#: RPDO 3 at the host's node id: motion programs, from the host to all cells.
PROGRAM = RPDO_BASES[2] + HOST_NODE
#: The one that says that a cell has none yet.
NODE_NONE = 255

#: Bit 31 of a COB-ID object: the service does not exist; bit 29: 29-bit identifier (not supported).
INVALID = 1 << 31
EXTENDED = 1 << 29
#: Bit 30: of a TPDO, remote requests are not answered, as no cell does; of SYNC, this device
#: produces it.
FLAG_30 = 1 << 30
IDENTIFIER = 0x7FF


def restricted(can_id: int) -> bool:
    """Whether CiA 301 keeps this identifier from use by a configurable service (table 41)."""
    return (
        can_id <= 0x07F
        or 0x101 <= can_id <= 0x180
        or 0x581 <= can_id <= 0x5FF
        or 0x601 <= can_id <= 0x67F
        or 0x6E0 <= can_id <= 0x6FF
        or can_id >= 0x701
    )
