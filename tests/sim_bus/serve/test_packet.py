import os

from hypothesis import given
from hypothesis import strategies as st

from mdms_protocol.codecs.frame import Frame
from mdms_sim.serve import packet


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.binary(max_size=8))), st.floats(0, 1e10))
def test_packets_carry_frames_and_times(frames, epoch_s):
    data = b"".join(packet.pack(Frame(*frame), epoch_s) for frame in frames)
    assert packet.unpack(data) == [(Frame(*frame), epoch_s) for frame in frames]


def test_packet_of_more_than_eight_bytes_makes_no_sense():
    data = bytearray(packet.pack(Frame(1, b"12345678"), 0.0))
    data[12] = 9
    assert packet.unpack(data) == [(Frame(1, b"12345678"), None)]


def test_channel_is_a_name_or_a_path(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert packet.socket_path("array18") == tmp_path / "mdms" / "array18.sock"
    assert packet.socket_path("./here.sock").name == "here.sock"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none"))
    assert packet.socket_path("array18").parent.name == f"mdms-{os.getuid()}"
