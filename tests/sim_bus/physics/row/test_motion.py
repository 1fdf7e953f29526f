import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mdms_sim.physics.row.motion import advance, basis, basis_series, first_zero, half_period


def plain(low, high):
    """Numbers whose products do not vanish by rounding."""
    return st.floats(low, high).filter(lambda x: x == 0.0 or abs(x) > 1e-100)


RATES = plain(-2000.0, 200.0)
DAMPINGS = plain(-200.0, 0.0)
VALUES = plain(-10.0, 10.0)


def flow(beta, gamma, speed, pull, time_s):
    """(dx, dv, acceleration) by the exponential of the matrix, in extended precision."""
    matrix = np.array([[0, 1, 0], [0, 0, 1], [0, beta, gamma]], dtype=np.longdouble)
    matrix *= np.longdouble(time_s)
    halvings = max(0, math.ceil(math.log2(max(1e-30, float(abs(matrix).max()))))) + 6
    matrix /= np.longdouble(2) ** halvings
    term = total = np.eye(3, dtype=np.longdouble)
    for k in range(1, 25):
        term = term @ matrix / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    x_m, v, a = total @ np.array([0, speed, pull], dtype=np.longdouble)
    return float(x_m), float(v - np.longdouble(speed)), float(a)


@given(beta=RATES, gamma=DAMPINGS, speed=VALUES, pull=VALUES, time_s=st.floats(1e-6, 20.0))
@example(beta=-1e-17, gamma=0.0, speed=1.0, pull=1.0, time_s=20.0)
@example(beta=0.0, gamma=-18.0, speed=1.0, pull=-1.0, time_s=20.0)
@example(beta=-1.0, gamma=-2.0, speed=1.0, pull=1.0, time_s=3.0)
@example(beta=-1.0, gamma=-2.0000001, speed=1.0, pull=1.0, time_s=3.0)
@example(beta=-1.0, gamma=-1.9999999, speed=1.0, pull=1.0, time_s=3.0)
@example(beta=1e-12, gamma=-1e-9, speed=0.0, pull=1.0, time_s=20.0)
@example(beta=5.0, gamma=-18.0, speed=0.0, pull=1.0, time_s=2.0)
def test_phase_moves_as_the_matrix_exponential_says(beta, gamma, speed, pull, time_s):
    if beta > 0.0:
        time_s = min(time_s, 5.0 / math.sqrt(beta))
    expected = flow(beta, gamma, speed, pull, time_s)
    reach = (abs(speed) + abs(pull) * time_s) * math.exp(math.sqrt(max(beta, 0.0)) * time_s)
    dx_m, dv, _ = advance(beta, gamma, speed, pull, time_s)
    assert dx_m == pytest.approx(expected[0], abs=1e-12 * reach * time_s, rel=0)
    assert dv == pytest.approx(expected[1], abs=1e-11 * reach, rel=0)


@given(beta=RATES, gamma=DAMPINGS, value=VALUES, slope=VALUES)
@example(beta=-2e-23, gamma=0.0, value=-0.2, slope=1.3)
@example(beta=0.0, gamma=0.0, value=1.0, slope=-2.0)
@example(beta=-1.36e-224, gamma=0.0, value=1.36e-224, slope=0.0)
def test_first_zero_is_a_zero_and_none_comes_before(beta, gamma, value, slope):
    zero_s = first_zero(beta, gamma, value, slope)
    if zero_s > 50.0 or math.sqrt(max(beta, 0.0)) * zero_s > 20.0:
        return

    def solution(time_s):
        s, integral = basis(beta, gamma, time_s)
        return value * (1.0 + beta * integral) + slope * s

    scale = abs(value) * (1.0 + abs(gamma) * zero_s) + abs(slope) * zero_s
    assert solution(zero_s) == pytest.approx(0.0, abs=1e-9 * scale + 1e-300)
    inside = [solution(part * zero_s) for part in np.linspace(0.01, 0.99, 25)]
    assert all(v >= -1e-12 * scale for v in inside) or all(v <= 1e-12 * scale for v in inside)


def test_swing_repeats_its_zeros_after_half_a_period():
    first_s = first_zero(-9.0, -0.4, 1.0, 0.5)
    second_s = first_s + half_period(-9.0, -0.4)
    _, dv, _ = advance(-9.0, -0.4, 1.0, 0.5, second_s)
    assert 1.0 + dv == pytest.approx(0.0, abs=1e-14)
    assert half_period(-1.0, -3.0) == math.inf


@pytest.mark.parametrize(("beta", "gamma"), [(-30.0, -3.0), (20.0, -4.0), (-4.0, -4.0)])
def test_series_and_closed_form_meet_where_one_takes_over(beta, gamma):
    for time_s in (0.06, 0.1, 0.14):
        assert basis(beta, gamma, time_s) == pytest.approx(
            basis_series(beta, gamma, time_s), rel=1e-12
        )
