"""Frames of the neighbour layer, bit by bit, on every interpreter, without allocating."""

from array import array

try:
    from micropython import heap_lock, heap_unlock
except ImportError:

    def heap_lock():
        """CPython has no lock."""

    def heap_unlock():
        """See `heap_lock`."""


from mdms_protocol.neighbours import frames as n

ESTIMATE_BITS = (12, 12, 12, 6, 2, 8, 4, 3, 2, 3)
ESTIMATES = (
    (0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    (-1, -1, -1, 63, 3, 255, 15, 5, 3, 7),
    (-2048, 2047, -2048, 1, 2, 0x81, 8, 3, 1, 1),
    (1234, -1234, 777, 42, 1, 0x5A, 9, 2, 2, 4),
)
PAGES = (
    ((5, n.PARCEL, 1, 1, 4095, 1120, 255, 200, 63), (6, 2, 2, 2, 12, 12, 8, 8, 6)),
    ((63, n.PARCEL, 3, 0, 1440, 4095, 98, 20, 1), (6, 2, 2, 2, 12, 12, 8, 8, 6)),
    ((1, n.PLACE, 2, -131_072, 131_071, -2048), (6, 2, 2, 18, 18, 12)),
    ((33, n.GOAL, 3, 54_321, -54_321, 2047, 0, 0), (6, 2, 2, 18, 18, 12, 3, 3)),
    ((34, n.GOAL, 1, -54_321, 54_321, -2048, n.JOINS, 5), (6, 2, 2, 18, 18, 12, 3, 3)),
    ((35, n.GOAL, 2, 1, -1, 0, 6, n.LEGS_MAX), (6, 2, 2, 18, 18, 12, 3, 3)),
    ((17, n.END, 1), (6, 2, 2)),
)


def number_of(values, bits):
    """The fields one after the other from bit 0 on, in integers of any size."""
    number = shift = 0
    for value, size in zip(values, bits):  # noqa: B905 - not in MicroPython
        number |= (value & (1 << size) - 1) << shift
        shift += size
    return number


def buffer(values, size):
    """Fields with these values, and one behind them that nobody is to touch."""
    made = array("i", [-77] * (size + 1))
    for place, value in enumerate(values):
        made[place] = value
    return made


def test_estimate_lies_in_its_frame_as_laid_down():
    for values in ESTIMATES:
        fields = buffer(values, n.ESTIMATE_FIELDS)
        frame = bytearray(10)
        heap_lock()
        n.pack_estimate(fields, frame, 2)
        heap_unlock()
        assert bytes(frame) == b"\0\0" + number_of(values, ESTIMATE_BITS).to_bytes(8, "little")
        read = buffer((), n.ESTIMATE_FIELDS)
        data = bytes(frame[2:])
        heap_lock()
        taken = n.unpack_estimate(data, read)
        heap_unlock()
        assert taken
        assert list(read) == list(fields)


def test_pages_lie_in_their_frames_as_laid_down():
    for values, bits in PAGES:
        fields = buffer(values, n.PROGRAM_FIELDS)
        frame = bytearray(8)
        heap_lock()
        n.pack_program(fields, frame)
        heap_unlock()
        assert bytes(frame) == number_of(values, bits).to_bytes(8, "little")
        read = buffer((), n.PROGRAM_FIELDS)
        heap_lock()
        taken = n.unpack_program(frame, read)
        heap_unlock()
        assert taken
        assert list(read)[: len(values)] == list(values)
        assert list(read)[len(values) :] == list(fields)[len(values) :]


def test_cell_clips_values_that_do_not_fit_and_lets_yaw_wrap():
    fields = array("i", (5000, -5000, 2049, 99, 9, 0x1FF, 99, 9, 9, 15))
    frame, read = bytearray(8), array("i", [0] * n.ESTIMATE_FIELDS)
    n.pack_estimate(fields, frame, 0)
    assert n.unpack_estimate(frame, read)
    assert tuple(read) == (2047, -2048, -2047, 63, 3, 255, 15, 5, 3, 7)
    fields = array("i", (70, n.GOAL, 9, 1 << 29, -(1 << 29), -2049, 0, 0, 0))
    n.pack_program(fields, frame)
    assert n.unpack_program(frame, fields)
    assert tuple(fields)[:6] == (63, n.GOAL, 3, 131_071, -131_072, 2047)


def test_frame_that_no_sender_makes_is_dropped():
    fields = array("i", [7] * n.ESTIMATE_FIELDS)
    for frame in (b"", bytes(7), bytes(9), bytes(7) + b"\x06", bytes(7) + b"\x07"):
        assert not n.unpack_estimate(frame, fields)
    no_identity, no_sequence, no_shape = b"\x00\x01", b"\x01\x00", b"\x01\x09"
    for head in (no_identity, no_sequence, no_shape):
        assert not n.unpack_program(head + bytes(6), fields)
    # Without an acceleration, and without a speed, of which no ramp would end.
    for last in (b"\x00\x40\x01\x00", b"\xc0\x02\x00\x00"):
        assert not n.unpack_program(b"\x01\x01\xfa\xe8" + last, fields)
    # Seven legs that follow, and the third of two.
    for last in (b"\xe0", b"\x4c"):
        assert not n.unpack_program(b"\x81\x01" + bytes(5) + last, fields)
    for size in (0, 7, 9):
        assert not n.unpack_program((b"\x01\x01" + bytes(7))[:size], fields)
    assert list(fields) == [7] * n.ESTIMATE_FIELDS
