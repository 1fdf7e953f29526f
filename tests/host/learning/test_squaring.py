"""The example that trains: its features, a policy that squares polygons up, and its picture."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from mdms_model.array import sensor_places_m

EXAMPLE = Path(__file__).parents[3] / "examples" / "squaring.py"


@pytest.fixture(scope="module")
def example():
    return runpy.run_path(str(EXAMPLE))


def test_polygons_are_upright_and_their_middle_of_mass_belongs_at_the_middle(example):
    for case in example["polygons"](3, 10):
        parcel = case.parcel[0]
        corners = np.array(parcel.corners_m) - parcel.centre_of_mass_m
        again = example["upright"](corners)
        np.testing.assert_allclose(again, corners, atol=1e-9)
        goal = np.array([parcel.goal.x_m, parcel.goal.y_m])
        np.testing.assert_allclose(goal + parcel.centre_of_mass_m, 0.0, atol=1e-9)
        # Inertia about y is that of the spread along x: the long axis.
        assert np.ptp(corners[:, 0]) > 0.9 * np.ptp(corners[:, 1])


def test_a_seed_has_the_same_polygons(example):
    assert example["polygons"](5, 3) == example["polygons"](5, 3)
    assert example["polygons"](5, 3) != example["polygons"](6, 3)


def test_features_show_place_and_angle_of_what_lies_on_the_sensors(example):
    table = example["TABLE"]
    places = sensor_places_m(table.array, table.cell).reshape(-1, 2)
    turn = 0.3
    arms = (places - [0.06, 0.01]) @ [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    covered = (abs(arms) < [0.20, 0.08]).all(axis=1)
    x, y, angle, one = example["features"](covered[None].astype(np.int8))[0]
    assert (x / 10, y / 10) == pytest.approx((0.06, 0.01), abs=0.02)
    assert angle == pytest.approx(turn, abs=0.08)
    assert one == 1.0


def test_a_policy_that_sees_sensors_earns_more_than_a_field(example):
    cases = example["polygons"](7, 12)
    numbers = np.tile(example["PROPORTIONAL"], (12, 1))
    steered = example["run"](cases, "twist", example["steered"](numbers))
    blind = example["run"](cases, "inward", example["inward"](0.2))
    assert np.median(steered["yaw_error_rad"]) < 0.5 * np.median(blind["yaw_error_rad"])
    assert steered["reward"].mean() > blind["reward"].mean() + 0.1


def test_training_test_and_picture_go_on_to_the_end(example, tmp_path):
    small = example["main"].__globals__
    small.update(POPULATION=4, CASES=2, TRIALS=2, TESTS=2, DURATION_S=1.0)
    example["main"](tmp_path, 2)
    assert (tmp_path / "squaring.png").stat().st_size > 10_000
    assert "results" in (tmp_path / "squaring.json").read_text()
