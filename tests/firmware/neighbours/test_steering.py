"""From a pose and a goal to a twist, in numbers that a 32-bit board bears."""

from math import hypot, sqrt
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_cell.neighbours import steering
from mdms_cell.neighbours.geometry.angle import ROOT_MAX, root
from mdms_cell.neighbours.steering import Steering, length

ways = st.integers(-3_000_000, 3_000_000)


@given(ways, ways, ways)
def test_length_is_that_of_the_vector_however_far_it_goes(x, y, z):
    wanted = sqrt(x * x + y * y + z * z)
    assert length(x, y, z) == pytest.approx(wanted, rel=2e-3, abs=180)


def test_goal_at_the_far_end_of_a_large_table_asks_for_no_root_that_a_board_cannot_take(
    monkeypatch,
):
    asked = []

    def noted(number):
        asked.append(number)
        return root(number)

    monkeypatch.setattr(steering, "root", noted)
    program = SimpleNamespace(acceleration_mm_s2=2_550, speed_um_s=1_275_000, any_yaw=False)
    steered = Steering()
    for _ in range(100):
        steered.step(program, 250_000, (1_500_000, 1_270_000, 0), may_go=True, step_ms=10)
    assert max(asked) <= ROOT_MAX
    assert hypot(steered.vx, steered.vy) == pytest.approx(1_275_000, rel=5e-3)
