"""Service data objects (CiA 301, 7.2.4): command specifiers, abort codes and expedited frames."""

# Command specifiers of client requests, in the upper three bits of the first byte
DOWNLOAD_SEGMENT = 0x00
DOWNLOAD = 0x20
UPLOAD = 0x40
UPLOAD_SEGMENT = 0x60
ABORT = 0x80
BLOCK_UPLOAD = 0xA0
BLOCK_DOWNLOAD = 0xC0

# and of the server's responses
UPLOAD_SEGMENT_RESPONSE = 0x00
DOWNLOAD_SEGMENT_RESPONSE = 0x20
UPLOAD_RESPONSE = 0x40
DOWNLOAD_RESPONSE = 0x60
BLOCK_DOWNLOAD_RESPONSE = 0xA0
BLOCK_UPLOAD_RESPONSE = 0xC0

SPECIFIER = 0xE0
EXPEDITED = 0x02
SIZE_TOLD = 0x01
TOGGLE = 0x10
LAST_SEGMENT = 0x01

# Block transfers: the lower bits of the first byte
BLOCK_SUBCOMMAND = 0x03
BLOCK_INITIATE = 0x00
BLOCK_END = 0x01
BLOCK_ACKNOWLEDGE = 0x02
BLOCK_START = 0x03
BLOCK_SIZE_TOLD = 0x02
BLOCK_CRC = 0x04
BLOCK_LAST = 0x80
BLOCK_SEQUENCE = 0x7F
#: Segments to a block that a cell asks for.
BLOCK_SEGMENTS = 63

# Abort codes (CiA 301, table 22)
TOGGLE_NOT_ALTERNATED = 0x05030000
TIMED_OUT = 0x05040000
UNKNOWN_COMMAND = 0x05040001
INVALID_BLOCK_SIZE = 0x05040002
INVALID_SEQUENCE = 0x05040003
CRC_ERROR = 0x05040004
OUT_OF_MEMORY = 0x05040005
UNSUPPORTED_ACCESS = 0x06010000
WRITE_ONLY = 0x06010001
READ_ONLY = 0x06010002
NO_SUCH_OBJECT = 0x06020000
NOT_MAPPABLE = 0x06040041
PDO_TOO_LONG = 0x06040042
INCOMPATIBLE = 0x06040043
HARDWARE_ERROR = 0x06060000
WRONG_LENGTH = 0x06070010
TOO_LONG = 0x06070012
TOO_SHORT = 0x06070013
NO_SUCH_SUB_INDEX = 0x06090011
INVALID_VALUE = 0x06090030
TOO_HIGH = 0x06090031
TOO_LOW = 0x06090032
GENERAL_ERROR = 0x08000000
CANNOT_STORE = 0x08000020
WRONG_STATE = 0x08000022
NO_DATA = 0x08000024


class AbortError(Exception):
    """A transfer that was refused, with its abort code."""

    def __init__(self, code: int) -> None:
        super().__init__("SDO abort code 0x%08X" % code)
        self.code = code


def read_request(index: int, sub: int) -> bytes:
    """The request to read an object."""
    return bytes((UPLOAD, index & 0xFF, index >> 8, sub, 0, 0, 0, 0))


def write_request(index: int, sub: int, value: bytes) -> bytes:
    """The expedited request to write 1 to 4 bytes; raises ValueError for more or fewer."""
    size = len(value)
    if not 1 <= size <= 4:
        raise ValueError("an expedited transfer carries 1 to 4 bytes, not %d" % size)
    command = DOWNLOAD | (4 - size) << 2 | EXPEDITED | SIZE_TOLD
    return bytes((command, index & 0xFF, index >> 8, sub)) + value + bytes(4 - size)


def abort(index: int, sub: int, code: int) -> bytes:
    """The frame that ends a transfer with an abort code."""
    return bytes((ABORT, index & 0xFF, index >> 8, sub)) + code.to_bytes(4, "little")


def crc16(data: bytes, crc: int) -> int:
    """Go on with the check of a block transfer: x^16 + x^12 + x^5 + 1, begun with 0."""
    for byte in data:
        byte ^= crc >> 8  # noqa: PLW2901 - no second name for what is the same byte
        byte ^= byte >> 4  # noqa: PLW2901
        crc = ((crc << 8) ^ (byte << 12) ^ (byte << 5) ^ byte) & 0xFFFF
    return crc
