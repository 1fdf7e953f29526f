import numpy as np
import pytest

from mdms_model.array import build_cells, build_wheels, cell_centres, reach_m
from mdms_model.scenario.scenario import Array, Cell, Patch, Scenario, Wheel

PAIR = (Wheel(0.0, (-0.03, 0.0)), Wheel(np.pi / 2, (0.03, 0.01)))


def scenario(**values):
    return Scenario("wheels", **{"array": Array(6, 3, 0.127), "cell": Cell(wheel=PAIR)} | values)


def test_cells_are_counted_along_x_first_about_the_middle():
    centres = cell_centres(Array(6, 3, 0.127))
    assert centres[0] == pytest.approx([-2.5 * 0.127, -0.127])
    assert centres[1] == pytest.approx([-1.5 * 0.127, -0.127])
    assert centres[17] == pytest.approx([2.5 * 0.127, 0.127])
    assert centres.sum(axis=0) == pytest.approx([0.0, 0.0])


def test_wheels_come_by_cell_then_axis():
    wheels = build_wheels(scenario())
    assert wheels.cell[:4].tolist() == [0, 0, 1, 1]
    assert wheels.position_m[35] == pytest.approx([2.5 * 0.127 + 0.03, 0.137])
    assert wheels.direction[:2].tolist() == [[1.0, 0.0], [0.0, 1.0]]
    assert wheels.first.tolist() == list(range(0, 37, 2))


def test_cells_of_a_mixed_array_have_wheels_of_their_own():
    wheels = build_wheels(scenario(patch=(Patch((2,), wheel=(Wheel(0.0),)),)))
    assert wheels.first[:4].tolist() == [0, 2, 3, 5]
    assert wheels.cell[:5].tolist() == [0, 0, 1, 2, 2]


def test_reach_is_the_farthest_along_either_axis():
    assert reach_m([(0.01, -0.03), (0.02, 0.0)]) == 0.03


def test_a_patch_changes_its_cells_only():
    own = (Wheel(0.0), Wheel(2.0), Wheel(4.0))
    cells = build_cells(
        scenario(cell=Cell(), patch=(Patch((2, 18), wheel=own), Patch((2,), friction=0.1)))
    )
    assert [len(cell.wheel) for cell in cells] == [1, 3] + [1] * 15 + [3]
    assert [cell.friction for cell in cells] == [0.3, 0.1] + [0.3] * 16
