"""What a cell's process and the simulation say to each other, little-endian.

A request is the size of its frames, whether to tick, presence bits, both counts and the time [ms],
then the frames that have reached the cell since the last request. A reply is its whole size and
both voltages [uV], then the frames that the cell wants to send. A frame is identifier, size, data.
"""

import struct

from mdms_protocol.frame import Frame

REQUEST = struct.Struct("<HBBiiI")
REPLY = struct.Struct("<Hii")
_FRAME_HEAD = struct.Struct("<HB")


def pack_frame(frame: Frame) -> bytes:
    """One frame with an 11-bit identifier."""
    data: bytes = frame.data
    return _FRAME_HEAD.pack(frame.can_id, len(data)) + data


def unpack_frames(data: bytes) -> list[Frame]:
    """The frames of a reply."""
    frames = []
    at = 0
    while at < len(data):
        can_id, size = _FRAME_HEAD.unpack_from(data, at)
        at += _FRAME_HEAD.size
        frames.append(Frame(can_id, data[at : at + size]))
        at += size
    return frames
