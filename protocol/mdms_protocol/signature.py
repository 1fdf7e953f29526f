"""One number over all stored settings of a cell, by which a host finds one that differs."""

import binascii

from mdms_protocol import packed, record

_STORED = record.STORED_COMMUNICATION | record.STORED_APPLICATION
_FLAGS_AT = 4
_PLACE_AT = 6


def _place(position: int) -> int:
    start = position * record.RECORD_SIZE + _PLACE_AT
    return packed.RECORDS[start] | packed.RECORDS[start + 1] << 8


def of(data: "bytes | bytearray") -> int:
    """The CRC-32 of the stored values among those of all entries, in the order of the table."""
    crc = 0
    for position in range(len(packed.RECORDS) // record.RECORD_SIZE - 1):
        if packed.RECORDS[position * record.RECORD_SIZE + _FLAGS_AT] & _STORED:
            crc = binascii.crc32(data[_place(position) : _place(position + 1)], crc)
    return crc
