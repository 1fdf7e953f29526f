import numpy as np
import pytest

from mdms_host.layout import Layout, WheelPlace


def test_cells_are_numbered_along_x_first_about_the_centre() -> None:
    layout = Layout(3, 2, pitch_m=0.1)
    expected = [[-0.1, -0.05], [0, -0.05], [0.1, -0.05], [-0.1, 0.05], [0, 0.05], [0.1, 0.05]]
    np.testing.assert_allclose(layout.cell_positions_m, expected, atol=1e-15)
    assert layout.node_ids == (1, 2, 3, 4, 5, 6)


def test_wheels_are_ordered_by_cell_then_by_axis() -> None:
    layout = Layout(2, 1, pitch_m=0.1, wheels=(WheelPlace(0.0), WheelPlace(np.pi / 2, (0.01, 0.0))))
    assert layout.wheel_cells.tolist() == [1, 1, 2, 2]
    expected_m = [[-0.05, 0], [-0.04, 0], [0.05, 0], [0.06, 0]]
    np.testing.assert_allclose(layout.wheel_positions_m, expected_m, atol=1e-15)
    np.testing.assert_allclose(layout.wheel_directions[:2], [[1, 0], [0, 1]], atol=1e-15)


def test_jacobian_agrees_with_the_motion_of_points_of_a_rigid_body() -> None:
    layout = Layout(4, 3, wheels=(WheelPlace(0.3, (0.02, 0.01)), WheelPlace(1.9, (0.0, -0.03))))
    twist, centre_m, step_s = np.array([0.2, -0.1, 0.7]), np.array([0.05, -0.02]), 1e-7
    turn = twist[2] * step_s
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    arm_m = layout.wheel_positions_m - centre_m
    moved_m = arm_m @ rotation.T + twist[:2] * step_s - arm_m
    along_m_s = (moved_m * layout.wheel_directions).sum(axis=1) / step_s
    np.testing.assert_allclose(layout.surface_jacobian(*centre_m) @ twist, along_m_s, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"columns": 0, "rows": 1}, "0 x 1"),
        ({"columns": 2, "rows": 1, "node_ids": (1, 1)}, "different node ids"),
        ({"columns": 2, "rows": 1, "node_ids": (1,)}, "2 cells need"),
        ({"columns": 1, "rows": 1, "node_ids": (127,)}, "1 to 126"),
    ],
)
def test_impossible_arrays_are_refused(arguments: dict, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        Layout(**arguments)
