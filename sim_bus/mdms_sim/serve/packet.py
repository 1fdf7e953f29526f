"""The protocol between a served bus and the python-can interface, over a Unix socket.

Both sides begin with `HELLO`, behind which the server tells the bit rate of its bus. Then packets
of fixed size follow, one a frame. The identifier carries the flags of `mdms_sim.bus.identifier`.
"""

import os
import struct
import tempfile
from pathlib import Path

from mdms_protocol.codecs.frame import Frame

HELLO = b"MDMSBUS2"
_BITRATE = struct.Struct("<I")
GREETING_SIZE = len(HELLO) + _BITRATE.size
_PACKET = struct.Struct("<dIB3x8s")
SIZE = _PACKET.size
_DATA_MAX = 8


def greeting(bitrate: int) -> bytes:
    """The first message of a server of a bus."""
    return HELLO + _BITRATE.pack(bitrate)


def bitrate_of(greeted: bytes) -> int:
    """The bit rate in a whole greeting."""
    (bitrate,) = _BITRATE.unpack(greeted[len(HELLO) :])
    return int(bitrate)


def pack(frame: Frame, epoch_s: float) -> bytes:
    """One packet; the time counts towards the client only."""
    return _PACKET.pack(epoch_s, frame.can_id, len(frame.data), frame.data)


def unpack(data: bytes | bytearray | memoryview) -> list[tuple[Frame, float | None]]:
    """The frames of whole packets with their times; None for the time of one that makes no sense.

    A packet makes no sense if it claims more than eight bytes.
    """
    frames: list[tuple[Frame, float | None]] = []
    for epoch_s, can_id, size, payload in _PACKET.iter_unpack(data):
        frames.append((Frame(can_id, payload[:size]), epoch_s if size <= _DATA_MAX else None))
    return frames


def runtime_folder() -> Path:
    """Where the sockets of this user's served buses are; only the user may enter."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    if base and os.access(base, os.W_OK):
        return Path(base) / "mdms"
    # Windows has no user numbers, and a folder for temporary files for each user.
    user = f"-{os.getuid()}" if hasattr(os, "getuid") else ""
    return Path(tempfile.gettempdir()) / f"mdms{user}"


def socket_path(channel: str) -> Path:
    """The socket of a served bus by name; a channel with a slash is a path itself."""
    return Path(channel) if "/" in channel else runtime_folder() / f"{channel}.sock"
