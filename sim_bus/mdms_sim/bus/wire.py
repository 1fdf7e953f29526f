"""A frame as bits on the wire: CRC, stuff bits (ISO 11898-1), and its length.

Every frame of a run goes through `frame_bits`, which works a byte at a time by table. The functions
that give the bits themselves are what tests hold it against.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdms_model.compiled import compiled, for_types_of
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.identifier import EXTENDED, REMOTE, STANDARD_MASK

CRC_POLYNOMIAL = 0x4599
CRC_BITS = 15
CRC_MASK = (1 << CRC_BITS) - 1
#: CRC delimiter, acknowledge slot and its delimiter, seven bits end of frame: never stuffed.
TAIL_BITS = 10
INTERFRAME_BITS = 3
STUFF_RUN = 5


@compiled
def header(can_id: int, size: int) -> tuple[int, int]:
    """Start of frame to DLC, as a number and its width [bits]."""
    remote = 1 if can_id & REMOTE else 0
    if can_id & EXTENDED:
        base, rest = (can_id >> 18) & STANDARD_MASK, can_id & 0x3FFFF
        return (base << 2 | 0b11) << 25 | rest << 7 | remote << 6 | size, 39
    return (can_id & STANDARD_MASK) << 7 | remote << 6 | size, 19


def stuffed_bits(frame: Frame) -> list[int]:
    """The bits from start of frame to the end of the CRC as they are sent, 0 dominant."""
    can_id, data = frame
    front, front_bits = header(can_id, len(data))
    payload = b"" if can_id & REMOTE else data
    content = front << 8 * len(payload) | int.from_bytes(payload, "big")
    width = front_bits + 8 * len(payload)
    content = content << CRC_BITS | _crc(content, width)
    return _stuff(content >> place & 1 for place in range(width + CRC_BITS - 1, -1, -1))


def _crc(content: int, width: int) -> int:
    crc = 0
    for place in range(width - 1, -1, -1):
        crc = crc << 1 ^ (CRC_POLYNOMIAL if content >> place & 1 ^ crc >> (CRC_BITS - 1) else 0)
        crc &= CRC_MASK
    return crc


def _stuff(bits: Iterable[int]) -> list[int]:
    sent: list[int] = []
    run = 0
    for bit in bits:
        run = run + 1 if sent and bit == sent[-1] else 1
        sent.append(bit)
        if run == STUFF_RUN:
            sent.append(1 - bit)
            run = 1
    return sent


# How a run of equal bits stands: 0 before the first, 1 to 4 so many zeros, 5 to 8 so many ones.
# Five of them make a stuff bit, which begins a run of the other.
_RUNS = 9
_ONES = 5


def _after_bit(run: int, bit: int) -> tuple[int, int]:
    """The run after a bit, and the number of stuff bits it made."""
    first = _ONES if bit else 1
    if not first <= run < first + STUFF_RUN - 1:
        return first, 0
    if run < first + STUFF_RUN - 2:
        return run + 1, 0
    return (1 if bit else _ONES), 1


def _after_bits(run: int, value: int, width: int) -> tuple[int, int]:
    stuffed = 0
    for place in range(width - 1, -1, -1):
        run, more = _after_bit(run, value >> place & 1)
        stuffed += more
    return run, stuffed


def _stuff_table(width: int) -> NDArray[np.int64]:
    """For each run and each value of `width` bits: the run after them above two bits of count."""
    table = np.empty((_RUNS, 1 << width), np.int64)
    for run in range(_RUNS):
        for value in range(1 << width):
            after, stuffed = _after_bits(run, value, width)
            table[run, value] = after << 2 | stuffed
    return table


def _crc_after(byte: int) -> int:
    crc = byte << (CRC_BITS - 8)
    for _ in range(8):
        crc = crc << 1 ^ (CRC_POLYNOMIAL if crc >> (CRC_BITS - 1) & 1 else 0)
    return crc & CRC_MASK


_HEAD = _stuff_table(3)
_BYTE = _stuff_table(8)
_CRC_END = _stuff_table(CRC_BITS - 8)
_CRC = np.array([_crc_after(byte) for byte in range(256)], np.int64)


@compiled
def _length(can_id: int, size: int, payload: Any) -> int:
    """Start of frame to end of frame; `payload` is the data as one big-endian number."""
    front, front_bits = header(can_id, size)
    data_bytes = 0 if can_id & REMOTE else size
    # The header is 19 or 39 bits long, so whole bytes but for three or seven at its beginning.
    whole = front_bits // 8
    begun = front >> 8 * whole
    crc = _CRC[begun]
    entry = _HEAD[0, begun] if front_bits % 8 == 3 else _CRC_END[0, begun]
    stuffed = entry & 3
    for place in range(whole + data_bytes - 1, -1, -1):
        if place >= data_bytes:
            byte = front >> 8 * (place - data_bytes) & 0xFF
        else:
            byte = np.int64(payload >> np.uint64(8 * place) & np.uint64(0xFF))  # type: ignore[assignment]
        entry = _BYTE[entry >> 2, byte]
        stuffed += entry & 3
        crc = _CRC[(crc >> (CRC_BITS - 8)) ^ byte] ^ (crc << 8 & CRC_MASK)
    entry = _BYTE[entry >> 2, crc >> (CRC_BITS - 8)]
    stuffed += entry & 3
    stuffed += _CRC_END[entry >> 2, crc & ((1 << (CRC_BITS - 8)) - 1)] & 3
    return int(front_bits + 8 * data_bytes + CRC_BITS + stuffed + TAIL_BITS)


_quick_length = for_types_of(_length, 0, 0, np.uint64(0))


def frame_bits(frame: Frame) -> int:
    """Length on the wire with the frame's real stuff bits, without the inter-frame space [bits]."""
    data = frame.data
    return _quick_length(frame.can_id, len(data), int.from_bytes(data, "big"))
