"""What a receiver makes of the bits it sees: where it finds an error, if any (ISO 11898-1)."""

from collections.abc import Sequence

from mdms_sim.bus.wire import CRC_BITS, CRC_MASK, CRC_POLYNOMIAL, STUFF_RUN

_IDE = 13
_STANDARD_HEADER, _STANDARD_RTR = 19, 12
_EXTENDED_HEADER, _EXTENDED_RTR = 39, 32
_LONGEST_DATA = 8
#: Delimiter, acknowledge slot, delimiter; then end of frame, whose last bit no longer matters.
_AFTER_CRC = 3
_END_OF_FRAME = 6
_RECESSIVE = 1


def first_error(bits: Sequence[int]) -> int | None:
    """Index of the bit at which a receiver that sees `bits` from start of frame finds an error.

    A wrong CRC is told at the delimiter after the acknowledge slot. After the last bit given, the
    bus is recessive. None for a good frame.
    """
    seen = [*bits, *([_RECESSIVE] * 2 * STUFF_RUN)]
    frame: list[int] = []
    wanted: int | None = None
    run = 0
    last = None
    for index, bit in enumerate(seen):
        if run == STUFF_RUN:
            if bit == last:
                return index
            run = 1
        else:
            if wanted is not None and len(frame) == wanted:
                return _tail_error(seen, index, frame)
            frame.append(bit)
            run = run + 1 if bit == last else 1
            wanted = wanted or _length(frame)
        last = bit
    return len(seen)


def _length(frame: list[int]) -> int | None:
    """Bits from start of frame to the end of the CRC, as soon as that can be told."""
    extended = len(frame) > _IDE and frame[_IDE]
    header = _EXTENDED_HEADER if extended else _STANDARD_HEADER
    if len(frame) < header:
        return None
    remote = frame[_EXTENDED_RTR if extended else _STANDARD_RTR]
    size = int("".join(map(str, frame[header - 4 : header])), 2)
    return header + (0 if remote else 8 * min(size, _LONGEST_DATA)) + CRC_BITS


def _tail_error(seen: Sequence[int], start: int, frame: list[int]) -> int | None:
    """An error in the delimiters, the CRC or the end of frame, which starts at `start`."""
    delimiter, acknowledge_delimiter = start, start + 2
    if not seen[delimiter]:
        return delimiter
    if _remainder(frame) or not seen[acknowledge_delimiter]:
        return acknowledge_delimiter
    end = start + _AFTER_CRC
    for index in range(end, end + _END_OF_FRAME):
        if not seen[index]:
            return index
    return None


def _remainder(frame: list[int]) -> int:
    crc = 0
    for bit in frame:
        crc = (crc << 1 | bit) ^ (CRC_POLYNOMIAL | 1 << CRC_BITS if crc >> (CRC_BITS - 1) else 0)
    return crc & CRC_MASK
