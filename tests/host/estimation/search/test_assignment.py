import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from mdms_host.estimation.roll_call import assign


@settings(deadline=None, max_examples=200)
@given(st.integers(1, 7), st.integers(0, 4), st.integers(0, 2**32 - 1), st.booleans())
def test_no_assignment_costs_less(rows: int, more: int, seed: int, whole: bool) -> None:
    random = np.random.default_rng(seed)
    cost = random.normal(0.0, 5.0, (rows, rows + more))
    cost = np.round(cost) if whole else cost
    columns = assign(cost)
    assert len(set(columns.tolist())) == rows
    best = cost[linear_sum_assignment(cost)].sum()
    assert abs(cost[np.arange(rows), columns].sum() - best) < 1e-9


def test_nobody_is_assigned_where_there_is_nobody() -> None:
    assert assign(np.zeros((0, 3))).tolist() == []
