"""A frame as bits on the wire: arbitration field, CRC, stuff bits, length (ISO 11898-1)."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mdms_protocol.frame import Frame
from mdms_sim.bus.flags import EXTENDED, EXTENDED_MASK, REMOTE, STANDARD_MASK

CRC_POLYNOMIAL = 0x4599
CRC_BITS = 15
CRC_MASK = (1 << CRC_BITS) - 1
#: CRC delimiter, acknowledge slot and its delimiter, seven bits end of frame: never stuffed.
TAIL_BITS = 10
INTERFRAME_BITS = 3
STUFF_RUN = 5
#: SOF, 29 identifier bits, SRR, IDE, RTR, r1, r0, DLC, 64 data bits, CRC, and every fourth stuffed.
LONGEST_BITS = 160


def arbitration_field(can_id: int) -> int:
    """What stations compare bit by bit, as one number of 32 bits: the lowest wins the bus."""
    remote = 1 if can_id & REMOTE else 0
    if not can_id & EXTENDED:
        return (can_id & STANDARD_MASK) << 21 | remote << 20
    identifier = can_id & EXTENDED_MASK
    return (identifier >> 18) << 21 | 0b11 << 19 | (identifier & 0x3FFFF) << 1 | remote


@numba.njit(cache=True)
def _header(can_id: int, size: int) -> tuple[int, int]:
    """Start of frame to DLC, as a number and its width [bits]."""
    remote = 1 if can_id & REMOTE else 0
    if can_id & EXTENDED:
        base, rest = (can_id >> 18) & STANDARD_MASK, can_id & 0x3FFFF
        return (base << 2 | 0b11) << 25 | rest << 7 | remote << 6 | size, 39
    return (can_id & STANDARD_MASK) << 7 | remote << 6 | size, 19


@numba.njit(cache=True)
def _send(can_id: int, size: int, payload: Any, out: Any) -> int:
    """Number of bits from start of frame to the end of the CRC; `out`, if any, is given them.

    `payload` is the data as one big-endian number.
    """
    header, header_bits = _header(can_id, size)
    data_bits = 0 if can_id & REMOTE else 8 * size
    crc = 0
    run = 0
    last = 2
    sent = 0
    for position in range(header_bits + data_bits + CRC_BITS):
        if position < header_bits:
            bit = (header >> (header_bits - 1 - position)) & 1
        elif position < header_bits + data_bits:
            # As an unsigned number, for all its 64 bits may be in use.
            shift = np.uint64(header_bits + data_bits - 1 - position)
            bit = np.int64((payload >> shift) & np.uint64(1))  # type: ignore[assignment]
        else:
            bit = (crc >> (header_bits + data_bits + CRC_BITS - 1 - position)) & 1
        if position < header_bits + data_bits:
            crc = (crc << 1) ^ (CRC_POLYNOMIAL if bit ^ (crc >> 14) else 0)
            crc &= CRC_MASK
        if out is not None:
            out[sent] = bit
        sent += 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == STUFF_RUN:
            last = 1 - bit
            run = 1
            if out is not None:
                out[sent] = last
            sent += 1
    return sent


@numba.njit("int64(int64, int64, uint64)", cache=True)
def _length(can_id: int, size: int, payload: Any) -> int:
    return _send(can_id, size, payload, None) + TAIL_BITS


@numba.njit("int64(int64, int64, uint64, uint8[::1])", cache=True)
def _bits(can_id: int, size: int, payload: Any, out: Any) -> int:
    return _send(can_id, size, payload, out)


def frame_bits(frame: Frame) -> int:
    """Length on the wire with the frame's real stuff bits, without the inter-frame space [bits]."""
    can_id, data = frame
    return _length(can_id, len(data), int.from_bytes(data, "big"))


def stuffed_bits(frame: Frame) -> NDArray[np.uint8]:
    """The bits from start of frame to the end of the CRC as they are sent, 0 dominant."""
    can_id, data = frame
    out = np.empty(LONGEST_BITS, np.uint8)
    return out[: _bits(can_id, len(data), int.from_bytes(data, "big"), out)]
