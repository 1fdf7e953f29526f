import numpy as np
import pytest

from mdms_model.run.record import History


def filled(offered, most):
    history = History(most)
    for number in range(offered):
        if history.takes():
            history.append(0.1 * number, number=np.array([number, -number]))
    return history


def test_everything_is_kept_without_a_bound():
    history = filled(25, None)
    np.testing.assert_allclose(history.time_s, 0.1 * np.arange(25))
    np.testing.assert_array_equal(history.columns()["number"][:, 1], -np.arange(25))


@pytest.mark.parametrize("offered", [7, 8, 9, 16, 1000, 1001])
@pytest.mark.parametrize("most", [8, 9])
def test_bounded_history_spans_the_whole_course_evenly(offered, most):
    numbers = filled(offered, most).columns()["number"][:, 0]
    strides = set(np.diff(numbers).tolist())
    assert len(numbers) <= most
    assert len(strides) == 1
    assert numbers[0] == 0
    assert numbers[-1] > offered - 1 - strides.pop()


def test_a_copy_has_no_sample_that_is_appended_later():
    history = filled(3, None)
    copied = history.copy()
    history.append(9.0, number=np.array([9, 9]))
    assert len(copied.time_s) == len(copied.columns()["number"]) == 3
