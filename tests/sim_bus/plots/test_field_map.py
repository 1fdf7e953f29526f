import numpy as np
import pytest

from mdms_model.array import build_wheels
from mdms_model.scenario.scenario import Array, Cell, Parcel, Scenario, Wheel
from mdms_sim.physics.analysis.field_map import map_field
from mdms_sim.plots.canvas import save
from mdms_sim.plots.field_map import draw_field_map

PLANE = (Wheel(0.0, (-0.03, 0.0)), Wheel(np.pi / 2, (0.03, 0.0)))


@pytest.mark.parametrize(
    ("array", "wheels", "panels"), [(Array(6, 3), PLANE, 2), (Array(10, 1), (Wheel(),), 1)]
)
def test_map_is_drawn_with_its_equilibria_and_saved(tmp_path, array, wheels, panels):
    scenario = Scenario("map $1", array, Cell(wheel=wheels), (Parcel("box", 2.0, 0.4445, 0.3),))
    placed = build_wheels(scenario)
    reference_m_s = -(np.sign(placed.position_m) * placed.direction).sum(axis=1)
    field = map_field(scenario, scenario.parcel[0], reference_m_s)
    figure = draw_field_map(scenario, scenario.parcel[0], field, reference_m_s)
    assert len(figure.axes) == panels
    shown = {tuple(line.get_xydata()[0]) for line in figure.axes[0].lines if len(line.get_xydata())}
    assert field.places
    assert {(rest.x_m, rest.y_m if panels == 2 else 0.0) for rest in field.places} <= shown
    save(figure, tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
