"""What stands above the identifier in a frame's `can_id`: the flags of Linux SocketCAN.

A plain 11-bit number is a plain data frame. A remote frame's `data` has the length it asks for.
"""

EXTENDED = 0x8000_0000
REMOTE = 0x4000_0000
#: An error frame; only tools are told of those.
ERROR = 0x2000_0000
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFF_FFFF
