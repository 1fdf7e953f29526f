import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.layout import Layout, WheelPlace
from mdms_model.fields import FIELDS, FieldError
from mdms_model.scenario.motion import Part

ROW = Layout(10, 1, wheels=(WheelPlace(0.0),))
GRID = Layout(6, 3)


def of(name: str, layout: Layout, **shape: object) -> np.ndarray:
    return FIELDS[name](layout.wheel_positions_m, layout.wheel_directions, Part(name, **shape))


def test_inward_on_a_row_is_the_papers() -> None:
    references = of("inward", ROW, speed_m_s=0.0635)
    np.testing.assert_array_equal(references, -np.sign(ROW.wheel_positions_m[:, 0]) * 0.0635)


def test_uniform_splits_the_speed_between_the_axes() -> None:
    references = of("uniform", GRID, speed_m_s=0.2, heading_rad=np.pi / 6).reshape(-1, 2)
    np.testing.assert_allclose(references, [[0.2 * np.cos(np.pi / 6), 0.1]] * 18)


def test_rotate_gives_the_full_speed_to_the_outermost_wheel_and_none_to_the_centre() -> None:
    layout = Layout(3, 3)
    references = of("rotate", layout, speed_m_s=0.1).reshape(-1, 2)
    np.testing.assert_allclose(references[4], 0.0, atol=1e-15)
    assert np.hypot(*references[8]) == pytest.approx(0.1)
    np.testing.assert_allclose(references[5], [0.0, 0.1 / np.sqrt(2)], atol=1e-15)


@given(*[st.floats(-1, 1) for _ in range(5)])
def test_twist_is_the_motion_of_a_rigid_body(
    vx: float, vy: float, yaw_rate: float, x_m: float, y_m: float
) -> None:
    told = of("twist", GRID, velocity_m_s=(vx, vy), yaw_rate_rad_s=yaw_rate, centre_m=(x_m, y_m))
    rigid = GRID.surface_jacobian(x_m, y_m) @ (vx, vy, yaw_rate)
    np.testing.assert_allclose(told, rigid, atol=1e-12)


def test_squeeze_pushes_across_the_line_only_and_to_it_from_both_sides() -> None:
    references = of("squeeze", GRID, speed_m_s=0.1, heading_rad=0.0).reshape(-1, 2)
    np.testing.assert_allclose(references[:, 0], 0.0, atol=1e-15)
    side = np.sign(GRID.cell_positions_m[:, 1])
    np.testing.assert_allclose(references[:, 1], -0.1 * side, atol=1e-15)


@given(st.floats(0.05, 1.0), st.floats(-np.pi, np.pi))
def test_elliptic_is_the_slope_of_an_elliptic_potential(ratio: float, heading: float) -> None:
    references = of("elliptic", GRID, speed_m_s=0.1, heading_rad=heading, ratio=ratio)
    reach_m = np.hypot(*GRID.wheel_positions_m.T).max()

    def potential(points_m: np.ndarray) -> np.ndarray:
        turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        own_m = points_m @ turn
        return 0.1 / reach_m * (own_m[:, 0] ** 2 + ratio * own_m[:, 1] ** 2) / 2

    step = 1e-5 * GRID.wheel_directions
    ahead, behind = GRID.wheel_positions_m + step, GRID.wheel_positions_m - step
    slope = (potential(ahead) - potential(behind)) / 2e-5
    np.testing.assert_allclose(references, -slope, atol=1e-9)


@pytest.mark.parametrize("name", sorted(set(FIELDS) - {"table"}))
def test_fields_move_along_with_their_centre(name: str) -> None:
    shift_m = np.array([0.4, -0.7])
    keys = {
        "speed_m_s": 0.3,
        "heading_rad": 0.4,
        "velocity_m_s": (0.1, -0.2),
        "yaw_rate_rad_s": 0.3,
        "gradient_per_s": ((0.5, -1.0), (0.2, -0.3)),
        "width_m": 0.25,
        "exit_rad": 2.0,
    }
    # Off the centre lines, where the sign of rounding errors would decide.
    places_m = GRID.wheel_positions_m + 0.01
    here, there = Part(name, **keys), Part(name, **keys, centre_m=(0.4, -0.7))
    np.testing.assert_allclose(
        FIELDS[name](places_m + shift_m, GRID.wheel_directions, there),
        FIELDS[name](places_m, GRID.wheel_directions, here),
        atol=1e-12,
    )


@given(st.lists(st.floats(-2, 2), min_size=6, max_size=6))
def test_linear_is_its_gradient_times_the_place_and_a_velocity(numbers: list[float]) -> None:
    xx, xy, yx, yy, vx, vy = numbers
    gradient = ((xx, xy), (yx, yy))
    linear = of("linear", GRID, gradient_per_s=gradient, velocity_m_s=(vx, vy))
    references = linear.reshape(-1, 2)
    first_m, second_m = GRID.wheel_positions_m[::2], GRID.wheel_positions_m[1::2]
    np.testing.assert_allclose(references[:, 0], first_m @ (xx, xy) + vx, atol=1e-12)
    np.testing.assert_allclose(references[:, 1], second_m @ (yx, yy) + vy, atol=1e-12)


def test_linear_without_a_curl_is_an_elliptic_field() -> None:
    reach_m = np.hypot(*GRID.wheel_positions_m.T).max()
    slope = -0.1 / reach_m
    linear = of("linear", GRID, gradient_per_s=((slope, 0.0), (0.0, 0.3 * slope)))
    np.testing.assert_allclose(linear, of("elliptic", GRID, speed_m_s=0.1, ratio=0.3), atol=1e-15)


def test_lane_carries_at_one_speed_and_gathers_to_its_middle_more_and_more_up_to_its_edges() -> (
    None
):
    lane = of("lane", GRID, speed_m_s=0.1, ratio=0.4, width_m=0.4).reshape(-1, 2)
    np.testing.assert_allclose(lane[:, 0], 0.1)
    across_m = GRID.wheel_positions_m[1::2, 1]
    np.testing.assert_allclose(lane[:, 1], -0.04 * across_m / 0.2, atol=1e-15)
    narrow = of("lane", GRID, speed_m_s=0.1, ratio=0.4, width_m=0.1).reshape(-1, 2)
    np.testing.assert_allclose(narrow[:, 1], -0.04 * np.sign(across_m), atol=1e-15)


def test_diverter_carries_along_until_the_line_through_its_centre_and_out_beyond() -> None:
    references = of("diverter", GRID, speed_m_s=0.1, exit_rad=np.pi / 2, centre_m=(0.1, 0.0))
    for (x_m, _), direction, reference in zip(
        GRID.wheel_positions_m, GRID.wheel_directions, references, strict=True
    ):
        push = (0.0, 0.1) if x_m >= 0.1 else (0.1, 0.0)
        assert reference == pytest.approx(float(direction @ push), abs=1e-15)


def test_table_is_taken_wheel_by_wheel() -> None:
    numbers = tuple(np.linspace(-1, 1, 10))
    np.testing.assert_array_equal(of("table", ROW, table_m_s=numbers), numbers)


def test_a_table_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(FieldError, match=r"each of the 10 wheels.*got 3"):
        of("table", ROW, table_m_s=(1.0, 2.0, 3.0))
