import numpy as np

from mdms_host.estimation.outlines.disc import Disc
from mdms_host.estimation.outlines.rectangle import Rectangle
from mdms_host.estimation.pose.feeling import turn_to_feel_rad
from mdms_host.layout import Layout

SENSORS_M = Layout(6, 3).sensor_positions_m.reshape(-1, 2)
ALL = np.ones(len(SENSORS_M), dtype=bool)
BOX = Rectangle(0.36, 0.30)
UNSURE_ACROSS = np.diag([1e-8, 2.5e-5, 1e-6])


def test_a_place_that_is_sure_needs_no_turn() -> None:
    assert turn_to_feel_rad(BOX, SENSORS_M, ALL, np.zeros(3), np.eye(3) * 1e-7) is None


def test_an_edge_passes_a_sensor_in_the_turn() -> None:
    pose = np.array([0.01, 0.012, 0.0])
    turn_rad = turn_to_feel_rad(BOX, SENSORS_M, ALL, pose, UNSURE_ACROSS)
    assert turn_rad is not None
    before = BOX.distance_m(SENSORS_M, pose) < 0
    assert (before != (BOX.distance_m(SENSORS_M, pose + np.array([0.0, 0.0, turn_rad])) < 0)).any()


def test_nothing_is_felt_for_with_no_sensors_or_round_parcels_or_those_that_might_tip() -> None:
    pose = np.array([0.01, 0.012, 0.0])
    assert turn_to_feel_rad(BOX, SENSORS_M, ~ALL, pose, UNSURE_ACROSS) is None
    assert turn_to_feel_rad(Disc(0.34), SENSORS_M, ALL, pose, UNSURE_ACROSS) is None
    small = Rectangle(0.30, 0.25)
    assert turn_to_feel_rad(small, SENSORS_M, ALL, pose, UNSURE_ACROSS) is None
