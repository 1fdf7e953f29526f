import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.array import build_wheels
from mdms_model.scenario.scenario import Array, Cell, Parcel, Scenario, Wheel
from mdms_sim.physics.plane.records import build_scene
from mdms_sim.physics.plane.resting import rest_parcels

PAIR = (Wheel(0.0, (-0.03, 0.0)), Wheel(np.pi / 2, (0.03, 0.02)))
TRIANGLE = ((-0.2, -0.15), (0.2, -0.1), (0.0, 0.15))
SHAPES = {
    "rectangle": {},
    "disc": {"width_m": 0.4},
    "polygon": {"corners_m": TRIANGLE},
}


def under(parcel, position_m):
    """Which wheels lie under a parcel, by looking at every one of them."""
    cosine, sine = np.cos(parcel.yaw_rad), np.sin(parcel.yaw_rad)
    x, y = ((position_m - [parcel.x_m, parcel.y_m]) @ [[cosine, -sine], [sine, cosine]]).T
    if parcel.shape == "disc":
        return np.hypot(x, y) <= parcel.length_m / 2
    if parcel.shape == "rectangle":
        return (abs(x) <= parcel.length_m / 2) & (abs(y) <= parcel.width_m / 2)
    corners = np.array(parcel.corners_m)
    along = np.roll(corners, -1, axis=0) - corners
    left = [s[0] * (y - c[1]) - s[1] * (x - c[0]) for c, s in zip(corners, along, strict=True)]
    return np.all(np.array(left) >= 0.0, axis=0)


@given(
    st.sampled_from(sorted(SHAPES)),
    st.tuples(st.floats(-0.5, 0.5), st.floats(-0.4, 0.4), st.floats(-7.0, 7.0)),
    st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
)
def test_supports_are_the_wheels_under_the_parcel(shape, pose, centre_of_mass_m):
    values = {"length_m": 0.4, "width_m": 0.3} | SHAPES[shape]
    parcel = Parcel(
        "one", 2.0, **values, x_m=pose[0], y_m=pose[1], yaw_rad=pose[2], shape=shape,
        centre_of_mass_m=centre_of_mass_m,
    )  # fmt: skip
    scenario = Scenario("scene", Array(6, 3), Cell(wheel=PAIR), (parcel,))
    scene = build_scene(scenario)
    rest_parcels(scene, 0.0)
    found = scene.scratch.wheels["parcel"] == 0
    assert found.tolist() == under(parcel, build_wheels(scenario).position_m).tolist()
    assert sorted(scene.scratch.support[: found.sum()]) == np.flatnonzero(found).tolist()


def test_wheels_exactly_at_the_edge_carry():
    parcel = Parcel("box", 2.0, 0.4445, 0.1, x_m=-0.34925)
    scene = build_scene(Scenario("row", Array(10, 1), Cell(), (parcel,)))
    rest_parcels(scene, 0.0)
    assert np.flatnonzero(scene.scratch.wheels["parcel"] == 0).tolist() == [0, 1, 2, 3]


def test_levers_are_about_the_centre_of_mass():
    parcel = Parcel("box", 2.0, 0.3, 0.3, x_m=0.05, centre_of_mass_m=(0.02, -0.03))
    scene = build_scene(Scenario("levers", Array(2, 2), Cell(wheel=PAIR), (parcel,)))
    rest_parcels(scene, 0.0)
    count = scene.scratch.parcels[0]["supports"]
    for w, row in zip(scene.scratch.support[:count], scene.scratch.jacobian[:count], strict=True):
        wheel = scene.model.wheels[w]
        arm = np.array([wheel["x_m"] - 0.07, wheel["y_m"] + 0.03])
        direction = np.array([wheel["direction_x"], wheel["direction_y"]])
        assert row[2] == pytest.approx(arm[0] * direction[1] - arm[1] * direction[0])


def test_a_wheel_under_two_parcels_carries_the_first():
    parcels = (Parcel("a", 2.0, 0.3, 0.3), Parcel("b", 2.0, 0.3, 0.3, x_m=0.1))
    scene = build_scene(Scenario("both", Array(6, 3), Cell(wheel=PAIR), parcels))
    rest_parcels(scene, 0.0)
    taken = np.bincount(scene.scratch.wheels["parcel"] + 1)[1:]
    assert taken.tolist() == scene.scratch.parcels["supports"].tolist()
    assert taken[0] > taken[1] > 0
