import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_protocol import pdo
from mdms_protocol.entry import OutOfRangeError

MAPS = (pdo.TARGET_VELOCITY, pdo.CONTROLWORD, pdo.ACTUAL_VELOCITY, pdo.STATUS)


@st.composite
def map_and_values(draw):
    carried = draw(st.sampled_from(MAPS))
    return carried, tuple(draw(st.integers(entry.low, entry.high)) for entry in carried.entries)


@given(map_and_values())
def test_encoded_values_are_decoded(case):
    carried, values = case
    data = carried.encode(values)
    assert len(data) == carried.length
    assert carried.decode(data) == values


def test_bytes_on_the_wire():
    assert pdo.TARGET_VELOCITY.encode((63_500, -63_500)) == bytes.fromhex("0cf80000 f407ffff")
    assert pdo.STATUS.encode((0x0250, 0x0637, 0x11)) == bytes.fromhex("5002 3706 11")
    assert pdo.TARGET_VELOCITY.can_id(18) == 0x212
    assert pdo.STATUS.can_id(18) == 0x292


def test_value_that_does_not_fit_is_refused_with_object_value_and_limits():
    with pytest.raises(OutOfRangeError, match=r"0x68FF:0 Axis 2 target velocity: 10000001 .*\.\."):
        pdo.TARGET_VELOCITY.encode((0, 10_000_001))
    with pytest.raises(OutOfRangeError, match="65536"):
        pdo.CONTROLWORD.encode((65_536, 0))
    with pytest.raises(ValueError, match="1 values for 2 objects"):
        pdo.CONTROLWORD.encode((0,))


@given(st.binary(max_size=8))
def test_frame_of_another_length_is_not_decoded(data):
    for carried in MAPS:
        assert (carried.decode(data) is None) == (len(data) != carried.length)
