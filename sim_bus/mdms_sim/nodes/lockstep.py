"""What a cell's process and the simulation say to each other, little-endian.

A request is eight 32-bit numbers, which MicroPython reads without allocating: the size of the
frames, what to do after having taken them in, presence bits, both encoder counts (the node id in
place of the first with `RESTART`), both motor currents [mA] and the time [ms]. Then come the frames
that have reached the cell since the last request. A reply is its whole size and both voltages [uV],
then the frames that the cell wants to send. A frame is identifier, size, data; under the identifier
`LISTEN` the data are the identifiers that the cell wants to hear from now on.
"""

import struct
from collections.abc import Iterator

from mdms_protocol.frame import Frame

NOTHING, TICK, RESTART, LEAVE_BUS, REJOIN_BUS = range(5)
LISTEN = 0xFFFF
#: Bytes of frames in one request at most.
FRAMES_MAX = 4096
FRAME_MAX = 11

REQUEST = struct.Struct("<8i")
REPLY = struct.Struct("<Hii")
_FRAME_HEAD = struct.Struct("<HB")


def pack_frame(frame: Frame) -> bytes:
    """One frame with an 11-bit identifier."""
    data: bytes = frame.data
    return _FRAME_HEAD.pack(frame.can_id, len(data)) + data


def unpack_frames(data: bytes) -> Iterator[Frame]:
    """The frames of a reply."""
    at = 0
    while at < len(data):
        can_id, size = _FRAME_HEAD.unpack_from(data, at)
        at += _FRAME_HEAD.size
        yield Frame(can_id, data[at : at + size])
        at += size


def identifiers(data: bytes) -> tuple[int, ...]:
    """What a `LISTEN` frame says."""
    return struct.unpack(f"<{len(data) // 2}H", data)
