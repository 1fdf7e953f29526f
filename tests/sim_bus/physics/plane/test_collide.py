import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.outline import outline_of
from mdms_model.parcel import Place
from mdms_model.scenario.scenario import Parcel
from mdms_sim.physics.plane.touch import Solid, closest

BOX = {"length_m": 0.4, "width_m": 0.2}
DISC = {"length_m": 0.2, "width_m": 0.2, "shape": "disc"}
TRIANGLE = BOX | {"shape": "polygon", "corners_m": ((-0.2, -0.1), (0.2, 0.0), (-0.1, 0.1))}


def solid(x_m, y_m, yaw_rad=0.0, **values):
    outline = outline_of(Parcel("solid", 1.0, **values))
    place = Place(x_m, y_m, np.cos(yaw_rad), np.sin(yaw_rad))
    return Solid(place, outline.edges, outline.radius_m)


def meet(a, b):
    points = np.full((2, 5), np.nan)
    return points[: closest(a, b, points)]


def test_boxes_side_by_side_meet_along_the_common_edge():
    points = meet(solid(0.0, 0.0, **BOX), solid(0.401, 0.05, **BOX))
    assert points[:, :2] == pytest.approx(np.array([[1.0, 0.0]] * 2))
    assert sorted(points[:, 3]) == pytest.approx([-0.05, 0.1])
    assert points[:, 4] == pytest.approx([0.001, 0.001])


def test_a_corner_meets_a_face_at_its_tip():
    points = meet(
        solid(0.0, 0.0, **BOX), solid(0.2 + 0.1 * 2**0.5, 0.0, np.pi / 4, **BOX | {"length_m": 0.2})
    )
    nearest = points[points[:, 4].argmin()]
    assert nearest == pytest.approx([1.0, 0.0, 0.2, 0.0, 0.0], abs=1e-12)


def test_the_other_way_round_turns_the_normal():
    a, b = solid(0.0, 0.0, **BOX), solid(0.301, 0.05, 0.1, **DISC)
    (there,), (back,) = meet(a, b), meet(b, a)
    assert there[:2] == pytest.approx([1.0, 0.0])
    assert back[:2] == pytest.approx([-1.0, 0.0])
    assert there[2:] == pytest.approx([0.2, 0.05, 0.001])
    assert back[4] == pytest.approx(there[4])


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7])
@pytest.mark.parametrize("kind", [BOX, TRIANGLE])
def test_a_disc_meets_every_face_where_it_is_next_to_it(kind, yaw_rad):
    body = solid(0.3, 0.2, yaw_rad, **kind)
    turn = np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])
    for normal, corner, end in zip(
        body.edges[:, :2], body.edges[:, 3:], np.roll(body.edges[:, 3:], -1, axis=0), strict=True
    ):
        for share in (0.1, 0.5, 0.8):
            on_face = corner + share * (end - corner)
            at = turn @ on_face + (0.3, 0.2)
            (point,) = meet(body, solid(*(at + turn @ normal * 0.102), **DISC))
            assert point == pytest.approx([*(turn @ normal), *at, 0.002], abs=1e-12)


def test_a_disc_meets_a_corner_along_the_line_between_them():
    (point,) = meet(solid(0.0, 0.0, **BOX), solid(0.2 + 0.08, 0.1 + 0.06, **DISC))
    assert point == pytest.approx([0.8, 0.6, 0.2, 0.1, 0.0], abs=1e-12)


def test_a_disc_pressed_into_a_face_is_pushed_out_of_it():
    (point,) = meet(solid(0.0, 0.0, **BOX), solid(0.19, 0.0, **DISC))
    assert point[:2] == pytest.approx([1.0, 0.0])
    assert point[4] == pytest.approx(-0.11)


def test_discs_meet_between_their_centres():
    (point,) = meet(solid(0.0, 0.0, **DISC), solid(0.0, 0.3, **DISC))
    assert point == pytest.approx([0.0, 1.0, 0.0, 0.1, 0.1])


@given(st.floats(0.0, 6.3), st.floats(-0.3, 0.3), st.floats(-7.0, 7.0))
def test_turning_the_table_turns_the_normal_and_keeps_the_gap(angle, y_m, yaw_rad):
    cosine, sine = np.cos(angle), np.sin(angle)
    x_m = 0.45
    plain = meet(solid(0.0, 0.0, **BOX), solid(x_m, y_m, yaw_rad, **BOX))
    there = (cosine * x_m - sine * y_m, sine * x_m + cosine * y_m)
    turned = meet(solid(0.0, 0.0, angle, **BOX), solid(*there, yaw_rad + angle, **BOX))
    assert turned[:, 4].min() == pytest.approx(plain[:, 4].min(), abs=1e-9)
