"""A frame as bits on the wire: arbitration field, CRC, stuff bits (ISO 11898-1)."""

from collections.abc import Iterable
from functools import lru_cache

from mdms_model.compiled import compiled
from mdms_protocol.codecs.frame import Frame

# The flags of Linux SocketCAN, above the identifier in a `can_id`. A plain 11-bit number is a plain
# data frame. A remote frame's `data` has the length it asks for.
EXTENDED = 0x8000_0000
REMOTE = 0x4000_0000
#: An error frame; only tools get those.
ERROR = 0x2000_0000
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFF_FFFF

CRC_POLYNOMIAL = 0x4599
CRC_BITS = 15
CRC_MASK = (1 << CRC_BITS) - 1
#: CRC delimiter, acknowledge slot and its delimiter, seven bits end of frame: never stuffed.
TAIL_BITS = 10
INTERFRAME_BITS = 3
STUFF_RUN = 5


@lru_cache(maxsize=4096)
def arbitration_field(can_id: int) -> int:
    """What stations compare bit by bit, as one number of 32 bits: the lowest wins the bus."""
    remote = 1 if can_id & REMOTE else 0
    if not can_id & EXTENDED:
        return (can_id & STANDARD_MASK) << 21 | remote << 20
    identifier = can_id & EXTENDED_MASK
    return (identifier >> 18) << 21 | 0b11 << 19 | (identifier & 0x3FFFF) << 1 | remote


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
