import numpy as np
import pytest

from mdms_model.array import build_wheels
from mdms_model.scenario.scenario import Array, Cell, Parcel, Scenario, Wheel
from mdms_sim.physics.field_map import map_field
from mdms_sim.plots.canvas import save
from mdms_sim.plots.field_map import draw_field_map, marker_size

PLANE = (Wheel(0.0, (-0.03, 0.0)), Wheel(np.pi / 2, (0.03, 0.0)))


@pytest.mark.parametrize(
    ("array", "wheels", "panels"), [(Array(6, 3), PLANE, 4), (Array(10, 1), (Wheel(),), 1)]
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
    assert {(rest.x_m, rest.y_m if panels > 1 else 0.0) for rest in field.places} <= shown
    save(figure, tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


def test_scale_of_the_shading_has_a_unit_and_no_equilibrium_hides_another():
    scenario = Scenario("map", Array(6, 3), Cell(wheel=PLANE), (Parcel("box", 2.0, 0.4445, 0.3),))
    placed = build_wheels(scenario)
    reference_m_s = -(np.sign(placed.position_m) * placed.direction).sum(axis=1)
    field = map_field(scenario, scenario.parcel[0], reference_m_s)
    figure = draw_field_map(scenario, scenario.parcel[0], field, reference_m_s)
    _, scale, _, rests = figure.axes
    assert scale.get_title() == "[N]"
    figure.canvas.draw()
    marks = rests.transData.transform([line.get_xydata()[0] for line in rests.lines])
    assert len(marks) == len(field.turns) > 3
    apart_px = np.hypot(*np.moveaxis(marks[:, None] - marks, 2, 0))[~np.eye(len(marks), dtype=bool)]
    assert apart_px.min() >= rests.lines[0].get_markersize() * figure.dpi / 72


def test_marks_near_to_each_other_are_smaller():
    places = np.array([(0.0, 0.0), (0.01, 0.0)])
    assert marker_size(places, (0.0, 0.0), 500.0) < 5.0
    assert marker_size(places, (0.5, 0.0), 500.0) == 11.0


@pytest.mark.filterwarnings("error")
def test_a_parcel_that_tips_wherever_it_lies_is_mapped():
    box = Parcel("box", 2.0, 0.05, 0.05, x_m=-0.1)
    scenario = Scenario("map", Array(6, 3), Cell(wheel=PLANE), (box,))
    placed = build_wheels(scenario)
    reference_m_s = -(np.sign(placed.position_m) * placed.direction).sum(axis=1)
    field = map_field(scenario, scenario.parcel[0], reference_m_s)
    assert not field.places
    assert len(draw_field_map(scenario, scenario.parcel[0], field, reference_m_s).axes) == 4
