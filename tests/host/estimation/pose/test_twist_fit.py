import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.estimation.pose.rolling import fit_twists

START = (0.0, 0.0, 0.0)
SEEDS = st.integers(0, 2**32 - 1)


def fit_twist(jacobian: np.ndarray, speeds: np.ndarray, start: tuple[float, ...]) -> np.ndarray:
    return fit_twists([jacobian], [speeds], np.array([start]))[0]


def wheels(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A Jacobian of wheels that push along x and y in turn, the twist, and the speeds it gives."""
    random = np.random.default_rng(seed)
    count = random.integers(6, 40)
    along = np.arange(count) % 2 * np.pi / 2
    jacobian = np.column_stack((np.cos(along), np.sin(along), random.uniform(-1, 1, count)))
    twist = random.uniform(-0.1, 0.1, 3)
    return jacobian, twist, jacobian @ twist


def reweighted(jacobian: np.ndarray, speeds: np.ndarray, start: tuple[float, ...]) -> np.ndarray:
    """The same by weighted least squares over all rows (QR), a ridge row for each column."""
    fit = np.array(start)
    for _ in range(5):
        error = np.abs(speeds - jacobian @ fit)
        scale = max(0.003, 1.5 * np.sort(error)[len(error) // 2])
        root = 1 / np.sqrt(1 + (error / scale) ** 2)
        ridge = np.sqrt(1e-10 * ((jacobian * root[:, None]) ** 2).sum())
        rows = np.vstack((jacobian * root[:, None], ridge * np.eye(3)))
        fit = np.linalg.lstsq(rows, np.concatenate((speeds * root, np.zeros(3))), rcond=None)[0]
    return fit


@given(SEEDS)
def test_wheels_that_agree_tell_the_twist(seed: int) -> None:
    jacobian, twist, speeds = wheels(seed)
    np.testing.assert_allclose(fit_twist(jacobian, speeds, START), twist, atol=1e-9)


@given(SEEDS, st.floats(0.0, 0.3))
def test_the_fit_is_reweighted_least_squares(seed: int, slip_m_s: float) -> None:
    jacobian, twist, speeds = wheels(seed)
    random = np.random.default_rng(seed)
    speeds = speeds + random.normal(0.0, 0.002, len(speeds))
    speeds[random.random(len(speeds)) < 0.3] += slip_m_s
    start = tuple((twist * random.uniform(0.5, 1.5)).tolist())
    expected = reweighted(jacobian, speeds, start)
    np.testing.assert_allclose(fit_twist(jacobian, speeds, start), expected, atol=1e-10)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_a_motion_that_no_wheel_shows_comes_out_as_zero(count: int) -> None:
    jacobian = np.zeros((count, 3))
    jacobian[:, 0] = 1.0
    fit = fit_twist(jacobian, np.full(count, 0.04), START)
    np.testing.assert_allclose(fit, (0.04, 0.0, 0.0), atol=1e-10)


def test_two_wheels_of_seven_that_slip_hardly_count() -> None:
    jacobian, twist, speeds = (part[:7] for part in wheels(3))
    speeds[[1, 4]] += 0.5
    np.testing.assert_allclose(fit_twist(jacobian, speeds, START), twist, atol=1e-3)


@given(st.lists(SEEDS, min_size=2, max_size=5))
def test_parcels_beside_each_other_change_nothing_for_any(seeds: list[int]) -> None:
    random = np.random.default_rng(seeds[0])
    all_wheels = [wheels(seed) for seed in seeds]
    jacobians = [jacobian for jacobian, _, _ in all_wheels]
    speeds = [speed + random.normal(0, 0.005, len(speed)) for _, _, speed in all_wheels]
    together = fit_twists(jacobians, speeds, np.zeros((len(seeds), 3)))
    for number, (jacobian, speed) in enumerate(zip(jacobians, speeds, strict=True)):
        assert (fit_twist(jacobian, speed, START) == together[number]).all()
