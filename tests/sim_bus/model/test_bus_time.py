"""Frames at their longest, and the share of a bus that cells and their host need."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.buses import BusTraffic, worst_bits
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.wire import INTERFRAME_BITS, frame_bits


def traffic(bitrate=1_000_000, sync_period_s=0.01):
    return BusTraffic(bitrate, sync_period_s, heartbeat_period_s=0.1, status_period_s=0.2)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_no_frame_is_longer_than_the_longest_of_its_size(can_id, data):
    assert frame_bits(Frame(can_id, data)) + INTERFRAME_BITS <= worst_bits(len(data))


@pytest.mark.parametrize(("size", "bits"), [(0, 55), (1, 65), (8, 135)])
def test_longest_frames_are_those_of_the_literature(size, bits):
    assert worst_bits(size) == bits


def test_load_is_the_sum_of_what_is_repeated():
    # SYNC and the host's heartbeat; setpoints and speeds, state, and heartbeat of each cell.
    expected = 100 * 55 + 10 * 65 + 18 * (100 * 2 * 135 + 5 * 105 + 10 * 65)
    assert traffic().load(18) == pytest.approx(expected / 1e6)
    assert traffic(500_000).load(18) == pytest.approx(expected / 5e5)


@pytest.mark.parametrize("bitrate", [50_000, 125_000, 500_000, 1_000_000])
@pytest.mark.parametrize("sync_period_s", [0.005, 0.01, 0.02])
def test_most_cells_are_those_within_the_limit(bitrate, sync_period_s):
    bus = traffic(bitrate, sync_period_s)
    most = bus.most_cells()
    assert bus.load(most + 1) > 0.8
    assert most == 0 or bus.load(most) <= 0.8


def test_forwarded_frames_come_at_every_sync():
    bus = traffic()
    assert bus.load(18, 12) - bus.load(18) == pytest.approx(12 * 100 * 135 / 1e6)
