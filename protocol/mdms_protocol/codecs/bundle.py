"""The head of a bundle: one firmware, signed for one array.

A bundle is this head and the content of a slot. The content is the size (u32) of an image of a
read-only file system (ROMFS) with the modules, and the image as a zlib stream with a window of 4
KB. The code (HMAC-SHA256 with the array's key) covers the head, and by the digest in it the rest.
So a cell refuses a wrong bundle in the first block, before it has erased anything.
"""

import struct
from collections import namedtuple

MAGIC = b"MDMB"
FORMAT = 1
#: magic, format, flags, bytecode, boards, version, counter, sizes, key identification, digest
_LAYOUT = "<4sBBHIIIII4s32s"
CODE_SIZE = 32
SIGNED_SIZE = struct.calcsize(_LAYOUT)
HEAD_SIZE = SIGNED_SIZE + CODE_SIZE
#: Flag: it may replace a newer version.
OLDER_ALLOWED = 1

#: `boards` has a bit for each board that it fits, `bytecode` is `sys.implementation._mpy` of
#: those, `version` as `version_number` has it. `size` and SHA-256 `digest` are those of what goes
#: into a slot, `image_size` that of the image in memory; `key_id` stands for the key. `counter`
#: goes up with every bundle of an array.
Head = namedtuple(
    "Head",
    (
        "flags",
        "bytecode",
        "boards",
        "version",
        "counter",
        "size",
        "image_size",
        "key_id",
        "digest",
    ),
)


def pack(head: Head) -> bytes:
    """The signed bytes of a head."""
    return struct.pack(_LAYOUT, MAGIC, FORMAT, *head)


def unpack(data: "bytes | bytearray") -> Head | None:
    """The head of a bundle, None if it is none."""
    if len(data) < HEAD_SIZE:
        return None
    magic, form, *fields = struct.unpack_from(_LAYOUT, data)
    if magic != MAGIC or form != FORMAT:
        return None
    return Head(*fields)


def version_number(text: str) -> int:
    """A version as a number that orders as versions do: 0x010203 of '1.2.3'; ValueError."""
    numbers = [int(each) for each in text.split(".")]
    if len(numbers) != 3 or max(numbers) > 0xFF or min(numbers) < 0:
        raise ValueError("a version is three numbers up to 255, not %r" % text)
    return numbers[0] << 16 | numbers[1] << 8 | numbers[2]


def version_text(number: int) -> str:
    """The version that a number stands for."""
    return "%d.%d.%d" % (number >> 16 & 0xFF, number >> 8 & 0xFF, number & 0xFF)
