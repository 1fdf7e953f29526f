import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.symmetric3 import solve


@given(st.integers(0, 10**6))
def test_solution_is_that_of_numpy(seed):
    chance = np.random.default_rng(seed)
    factor = chance.normal(size=(3, 3))
    matrix = factor @ factor.T + 0.1 * np.eye(3)
    right = chance.normal(size=3)
    solution = solve(tuple(matrix[np.triu_indices(3)]), tuple(right))
    assert solution == pytest.approx(np.linalg.solve(matrix, right), rel=1e-6, abs=1e-9)
