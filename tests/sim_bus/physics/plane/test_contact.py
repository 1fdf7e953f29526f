import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_sim.physics.plane.contact import Pushes, push, settle

INERTIA_PER_S = (2000.0, 2000.0, 40.0)
speeds = st.floats(-3.0, 3.0)


def problem(seed, count):
    chance = np.random.default_rng(seed)
    angle = chance.uniform(0.0, 2 * np.pi, count)
    jacobian = np.column_stack([np.cos(angle), np.sin(angle), chance.uniform(-0.3, 0.3, count)])
    slope = 10.0 ** chance.uniform(-1.0, 5.0, count)
    limit = np.where(chance.random(count) < 0.2, 0.0, chance.uniform(0.0, 5.0, count))
    line = np.column_stack([slope * chance.uniform(-2.0, 2.0, count), slope, limit])
    return Pushes(jacobian, line, np.zeros(count, dtype=np.int8))


def forces(pushes, twist):
    wanted = pushes.line[:, 0] - pushes.line[:, 1] * (pushes.jacobian @ twist)
    return np.clip(wanted, -pushes.line[:, 2], pushes.line[:, 2])


@given(st.integers(0, 10**6), st.integers(0, 40), st.tuples(speeds, speeds, speeds))
def test_momentum_gained_is_what_the_clipped_lines_push(seed, count, twist):
    pushes = problem(seed, count)
    *new, steps = settle(twist, INERTIA_PER_S, pushes)
    gained = np.array(INERTIA_PER_S) * (np.array(new) - twist)
    given_n = pushes.jacobian.T @ forces(pushes, new)
    # A slope of 1e5 N s/m turns a last digit of speed into 1e-10 N.
    assert gained == pytest.approx(given_n, abs=1e-8)
    assert steps < 30


def test_a_parcel_that_rolls_on_is_found_in_one_step():
    jacobian = np.array([[1.0, 0.0, 0.1], [1.0, 0.0, -0.1], [0.0, 1.0, 0.0]])
    line = np.array([[0.9, 9.0, 6.0], [0.9, 9.0, 6.0], [0.0, 9.0, 6.0]])
    pushes = Pushes(jacobian, line, np.zeros(3, dtype=np.int8))
    assert settle((0.1, 0.0, 0.0), INERTIA_PER_S, pushes) == (0.1, 0.0, 0.0, 1)


def test_pieces_tell_who_slips():
    jacobian = np.array([[1.0, 0.0, 0.0]] * 3)
    line = np.array([[100.0, 10.0, 2.0], [-100.0, 10.0, 2.0], [0.0, 10.0, 2.0]])
    pushes = Pushes(jacobian, line, np.zeros(3, dtype=np.int8))
    *twist, _ = settle((0.0, 0.0, 0.0), INERTIA_PER_S, pushes)
    assert twist == [0.0, 0.0, 0.0]
    assert pushes.piece.tolist() == [1, -1, 0]


def test_one_wheel_pushes_along_its_line_between_its_limits():
    row = np.array([1.0, 0.0, 0.2])
    line = np.array([3.0, 10.0, 2.0])
    assert push(line, row, (0.2, 5.0, 0.5)) == pytest.approx(3.0 - 10.0 * 0.3)
    assert push(line, row, (0.0, 0.0, 0.0)) == 2.0
    assert push(line, row, (1.0, 0.0, 0.0)) == -2.0
