"""The `can_id` of a frame on a bus: its identifier, and flags above it.

Programs that only talk to a served bus need no more of it, and no compiler.
"""

from functools import lru_cache

# The flags of Linux SocketCAN. A plain 11-bit number is a plain data frame. A remote frame's `data`
# has the length it asks for.
EXTENDED = 0x8000_0000
REMOTE = 0x4000_0000
#: An error frame; only tools get those.
ERROR = 0x2000_0000
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFF_FFFF


@lru_cache(maxsize=4096)
def arbitration_field(can_id: int) -> int:
    """The bits that stations compare, as one number of 32 bits: the lowest wins the bus."""
    remote = 1 if can_id & REMOTE else 0
    if not can_id & EXTENDED:
        return (can_id & STANDARD_MASK) << 21 | remote << 20
    identifier = can_id & EXTENDED_MASK
    return (identifier >> 18) << 21 | 0b11 << 19 | (identifier & 0x3FFFF) << 1 | remote
