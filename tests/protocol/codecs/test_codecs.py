"""NMT, the drive's states, COB-IDs and SDO frames against the tables of the standards."""

import binascii

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_protocol.codecs import cia402, cob, nmt, sdo


def test_nmt_command_frames():
    assert nmt.command(nmt.START) == (0x000, b"\x01\x00")
    assert nmt.command(nmt.RESET_COMMUNICATION, 5) == (0x000, b"\x82\x05")


@pytest.mark.parametrize(("code", "node_id"), [(0x03, 5), (nmt.START, 128), (nmt.START, -1)])
def test_impossible_nmt_command_is_refused(code, node_id):
    with pytest.raises(ValueError, match="is no"):
        nmt.command(code, node_id)


@given(st.binary(max_size=8))
def test_heartbeat_is_one_byte_with_a_state(data):
    expected = data[0] if len(data) == 1 and data[0] in (0x00, 0x04, 0x05, 0x7F) else None
    assert nmt.decode_heartbeat(data) == expected


def test_heartbeat_frame():
    assert nmt.heartbeat(5, nmt.OPERATIONAL) == (0x705, b"\x05")


def test_statusword_tells_the_state_whatever_the_other_bits():
    # CiA 402-2, table 30: mask, value
    table = {
        cia402.NOT_READY: (0x4F, 0x00),
        cia402.SWITCH_ON_DISABLED: (0x4F, 0x40),
        cia402.READY_TO_SWITCH_ON: (0x6F, 0x21),
        cia402.SWITCHED_ON: (0x6F, 0x23),
        cia402.OPERATION_ENABLED: (0x6F, 0x27),
        cia402.QUICK_STOP_ACTIVE: (0x6F, 0x07),
        cia402.FAULT_REACTION: (0x4F, 0x0F),
        cia402.FAULT: (0x4F, 0x08),
    }
    for word in range(0x10000):
        fitting = [state for state, (mask, value) in table.items() if word & mask == value]
        assert cia402.state(word) == (fitting[0] if fitting else None)


def test_restricted_identifiers():
    allowed = {can_id for can_id in range(0x800) if not cob.restricted(can_id)}
    used = set(range(0x181, 0x580 + 1)) | {0x80} | set(range(0x81, 0x101)) | {0x100}
    assert used <= allowed
    for can_id in (0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x701, 0x7FF):
        assert can_id not in allowed


def test_sdo_requests():
    assert sdo.read_request(0x1018, 4) == bytes.fromhex("40 1810 04 00000000")
    assert sdo.write_request(0x3000, 0, b"\x4d\x00") == bytes.fromhex("2b 0030 00 4d000000")
    assert sdo.abort(0x3000, 0, sdo.TOO_HIGH) == bytes.fromhex("80 0030 00 31000906")


@pytest.mark.parametrize("value", [b"", b"12345"])
def test_expedited_write_of_another_size_is_refused(value):
    with pytest.raises(ValueError, match=f"not {len(value)}"):
        sdo.write_request(0x3000, 0, value)


@given(st.binary(max_size=300), st.integers(0, 300))
def test_crc_is_that_of_xmodem_and_may_be_taken_in_pieces(data, cut):
    assert sdo.crc16(data[cut:], sdo.crc16(data[:cut], 0)) == binascii.crc_hqx(data, 0)
