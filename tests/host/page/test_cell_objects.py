"""Values of a cell are shown with their meaning, in the digits of tools and standards."""

import pytest

from mdms_host.page.cell_objects import name_of, reading_of
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import WRITE


@pytest.mark.parametrize(
    ("index", "sub", "value", "reading"),
    [
        (0x1400, 1, 0x0000_0205, "0x205"),
        (0x1800, 1, 0x8000_0185, "0x185, off"),
        (0x1005, 0, 0x4000_0080, "0x080, sent by this cell"),
        (0x1005, 0, 0x0000_0080, "0x080"),
        (0x1A00, 1, 0x606C_0020, "0x606C0020, Axis 1 velocity actual value"),
        (0x1A00, 3, 0, "none"),
        (0x1A00, 3, 0x5FFF_0120, "0x5FFF0120, nothing that there is"),
        (0x1016, 1, 0x007F_012C, "node 127 within 300 ms"),
        (0x1000, 0, 0x0002_0192, "0x00020192"),
        (0x6041, 0, 0x0637, "0x0637, operation enabled"),
        (0x6841, 0, 0x0000, "0x0000, not ready to switch on"),
        (0x603F, 0, 0x3220, "0x3220: supply below the undervoltage limit"),
        (0x603F, 0, 0, "none"),
        (0x606C, 0, -123_456, "-0.123456 m/s"),
        (0x6078, 0, 250, "25 %"),
        (0x2000, 0, 10_000, "10 V s/m"),
        (0x3001, 0, 0b10110, "0b10110"),
        (0x3002, 1, 12_345, "12345"),
    ],
)
def test_values_are_read_as_people_write_them(index, sub, value, reading):
    assert reading_of(ENTRIES[index, sub], value) == reading


def test_every_object_has_a_reading_and_a_name_of_its_own():
    assert name_of(ENTRIES[0x1016, 1]) == "Consumer heartbeat time 1"
    assert name_of(ENTRIES[0x1018, 1]) == "Identity object: Vendor-ID"
    names = [name_of(entry) for entry in ENTRIES.values()]
    assert len(set(names)) == len(names)
    for entry in ENTRIES.values():
        if entry.type.size and entry.access != WRITE:
            assert reading_of(entry, entry.type.high)
