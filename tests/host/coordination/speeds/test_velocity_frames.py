import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.coordination.wheel_speeds import VelocityFrames
from mdms_protocol import pdo
from mdms_protocol.entry import OutOfRangeError

LIMIT_UM_S = pdo.TARGET_VELOCITY.entries[0].high
UM_S = st.integers(-LIMIT_UM_S, LIMIT_UM_S)


@given(st.lists(st.tuples(UM_S, UM_S), min_size=3, max_size=3))
def test_all_cells_at_once_get_the_setpoints_of_each(cells: list[tuple[int, int]]) -> None:
    frames = VelocityFrames((5, 6, 9), 2).targets(np.ravel(cells) / 1e6)
    assert [frame.can_id for frame in frames] == [0x205, 0x206, 0x209]
    assert [frame.data for frame in frames] == [pdo.TARGET_VELOCITY.encode(each) for each in cells]


@given(st.lists(st.tuples(UM_S, UM_S), min_size=2, max_size=2))
def test_all_cells_at_once_tell_the_speeds_of_each(cells: list[tuple[int, int]]) -> None:
    told = [pdo.ACTUAL_VELOCITY.encode(each) for each in cells]
    np.testing.assert_allclose(
        VelocityFrames((1, 2), 2).actual_m_s(told), np.ravel(cells) / 1e6, rtol=1e-15
    )


def test_an_axis_that_is_not_used_is_told_zero_and_not_listened_to() -> None:
    frames = VelocityFrames((1, 2), 1)
    sent = [pdo.TARGET_VELOCITY.decode(frame.data) for frame in frames.targets(np.full(2, 0.1))]
    assert sent == [(100_000, 0), (100_000, 0)]
    told = [pdo.ACTUAL_VELOCITY.encode((each, 77)) for each in (1, 2)]
    np.testing.assert_allclose(frames.actual_m_s(told), [1e-6, 2e-6])


@pytest.mark.parametrize("wrong_m_s", [10.1, -10.1])
def test_a_velocity_that_no_drive_takes_is_refused_with_its_object(wrong_m_s: float) -> None:
    frames = VelocityFrames((1, 2), 2)
    with pytest.raises(OutOfRangeError, match=r"0x68FF.*10100000"):
        frames.targets(np.array([0.0, 10.0, 0.0, wrong_m_s]))
