"""`crc32` for builds of MicroPython that leave `binascii` out; copy it as `binascii.py`."""

_POLYNOMIAL = 0xEDB88320


def _nibble(value):
    for _ in range(4):
        value = value >> 1 ^ (_POLYNOMIAL if value & 1 else 0)
    return value


_TABLE = tuple(_nibble(value) for value in range(16))


def crc32(data, value=0):
    """The CRC-32 of `data`, continuing from `value`."""
    crc = value ^ 0xFFFFFFFF
    for byte in data:
        crc = crc >> 4 ^ _TABLE[(crc ^ byte) & 15]
        crc = crc >> 4 ^ _TABLE[(crc ^ byte >> 4) & 15]
    return crc ^ 0xFFFFFFFF
