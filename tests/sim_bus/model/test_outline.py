import numpy as np
import pytest

from mdms_model.outline import outline_of
from mdms_model.scenario.scenario import Parcel, ScenarioError


def parcel(**values):
    return Parcel("box", mass_kg=2.0, **{"length_m": 0.4, "width_m": 0.2} | values)


def test_a_rectangle_has_the_moment_of_a_plate():
    outline = outline_of(parcel())
    assert outline.moment_m2 == pytest.approx((0.4**2 + 0.2**2) / 12)
    assert outline.radius_m == pytest.approx(np.hypot(0.2, 0.1))
    assert outline.edges[:, 2] == pytest.approx([0.2, 0.1, 0.2, 0.1])


def test_a_disc_is_a_circle_alone():
    outline = outline_of(parcel(shape="disc", width_m=0.4))
    assert (len(outline.edges), outline.radius_m) == (0, 0.2)
    assert outline.moment_m2 == pytest.approx(0.2**2 / 2)


def test_a_polygon_of_many_corners_is_like_a_disc():
    angle = np.arange(360) * 2 * np.pi / 360
    corners = tuple(map(tuple, 0.2 * np.column_stack([np.cos(angle), np.sin(angle)])))
    outline = outline_of(parcel(shape="polygon", width_m=0.4, corners_m=corners))
    assert outline.moment_m2 == pytest.approx(0.2**2 / 2, rel=1e-3)


def test_a_triangle_has_its_moment_about_its_own_centroid():
    corners = ((-0.2, -0.1), (0.2, -0.1), (-0.2, 0.1))
    outline = outline_of(parcel(shape="polygon", corners_m=corners))
    assert outline.moment_m2 == pytest.approx((0.4**2 + 0.2**2) / 18)


@pytest.mark.parametrize(
    "corners",
    [
        (),
        ((0.0, 0.0), (0.1, 0.0)),
        ((0.0, 0.0), (0.0, 0.1), (0.1, 0.0)),
        ((0.0, 0.0), (0.1, 0.0), (0.02, 0.02), (0.0, 0.1)),
        ((0.1, 0.0), (-0.08, 0.06), (0.03, -0.095), (0.03, 0.095), (-0.08, -0.06)),
    ],
    ids=["none", "two", "clockwise", "concave", "star"],
)
def test_corners_that_make_no_convex_polygon_are_refused(corners):
    with pytest.raises(ScenarioError, match="counter-clockwise"):
        outline_of(parcel(shape="polygon", corners_m=corners))


def test_corners_beyond_the_box_are_refused():
    with pytest.raises(ScenarioError, match="within its length_m"):
        outline_of(parcel(shape="polygon", corners_m=((0.0, 0.0), (0.3, 0.0), (0.0, 0.1))))


def test_an_oval_disc_is_refused():
    with pytest.raises(ScenarioError, match="one diameter"):
        outline_of(parcel(shape="disc"))
