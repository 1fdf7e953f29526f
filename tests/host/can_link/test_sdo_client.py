import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.can_link.sdo_client import Read, SdoClient, Setting
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.entry import OutOfRangeError

GAIN = Setting(0x2000, 0, 8_000)
TIMEOUT = Setting(0x3000, 0, 80)
TAKEN = bytes.fromhex("6000200000000000")


def test_settings_go_one_after_another() -> None:
    client = SdoClient(5, (GAIN, TIMEOUT))
    assert list(client.poll(0.0)) == [Frame(0x605, bytes.fromhex("23002000401f0000"))]
    assert list(client.poll(0.01)) == []
    client.on_response(TAKEN)
    assert list(client.poll(0.02)) == [Frame(0x605, bytes.fromhex("2b00300050000000"))]
    client.on_response(bytes.fromhex("6000300000000000"))
    assert client.done
    assert client.failure is None


def test_a_negative_value_goes_in_twos_complement() -> None:
    client = SdoClient(1, (Setting(0x60FF, 0, -2),))
    assert list(client.poll(0.0)) == [Frame(0x601, bytes.fromhex("23ff6000feffffff"))]


def test_a_read_value_is_kept_with_its_sign() -> None:
    client = SdoClient(1, (Read(0x6041, 0), Read(0x606C, 0)))
    assert list(client.poll(0.0)) == [Frame(0x601, bytes.fromhex("4041600000000000"))]
    client.on_response(bytes.fromhex("4b41600027020000"))
    assert list(client.poll(0.0)) == [Frame(0x601, bytes.fromhex("406c600000000000"))]
    client.on_response(bytes.fromhex("436c6000feffffff"))
    assert client.answers == {(0x6041, 0): 0x227, (0x606C, 0): -2}


def test_an_answer_longer_than_a_frame_is_a_failure() -> None:
    client = SdoClient(1, (Read(0x1000, 0),))
    list(client.poll(0.0))
    client.on_response(bytes.fromhex("4100100009000000"))
    assert client.failure == "its answer to a read of 0x1000:0 is longer than a frame"


def test_a_lost_request_is_sent_again_and_given_up_after_three() -> None:
    client = SdoClient(5, (GAIN,))
    sent = [now_ms for now_ms in range(0, 1000, 10) if list(client.poll(now_ms / 1000))]
    assert sent == [0, 100, 200]
    assert client.failure == "no answer to a write of 8000 to 0x2000:0 after 3 attempts"


def test_a_refusal_is_told_with_its_code() -> None:
    client = SdoClient(5, (GAIN,))
    list(client.poll(0.0))
    client.on_response(bytes.fromhex("8000200030000906"))
    assert client.failure == "it refuses a write of 8000 to 0x2000:0 (abort code 0x06090030)"
    assert list(client.poll(1.0)) == []


@given(st.binary(max_size=8).filter(lambda data: data[:4] != TAKEN[:4]))
def test_no_answer_but_the_right_one_counts(data: bytes) -> None:
    client = SdoClient(5, (GAIN,))
    list(client.poll(0.0))
    client.on_response(data)
    assert not client.done


def test_a_value_out_of_range_is_refused_before_it_is_sent() -> None:
    with pytest.raises(OutOfRangeError, match="0x2000"):
        list(SdoClient(5, (Setting(0x2000, 0, 100_001),)).poll(0.0))
