"""Which frames a cell's acceptance filter lets through."""

from mdms_protocol import cob


def identifiers(node_id: int) -> frozenset[int]:
    """Network control, SYNC, the node's receive PDOs and SDO requests, LSS, all heartbeats."""
    return frozenset(
        [
            cob.NMT,
            cob.SYNC,
            *(base + node_id for base in cob.RPDO_BASES),
            cob.SDO_REQUEST_BASE + node_id,
            cob.LSS_REQUEST,
        ]
    )
