import numpy as np

from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.tracker import Parcel, Tracker
from mdms_host.layout import Layout

LAYOUT = Layout(12, 3)
LEFT, RIGHT = Parcel("left", 0.36, 0.30, (-0.4, 0.0)), Parcel("right", 0.25, 0.20, (0.4, 0.0))
AT = {"left": (-0.38, 0.02, 0.1), "right": (0.41, -0.03, -0.2)}
STILL = np.zeros(len(LAYOUT.wheel_cells))


def bits_under(parcels: tuple[Parcel, ...]) -> list[int]:
    sensors_m = LAYOUT.sensor_positions_m
    covered = np.zeros(sensors_m.shape[:2], dtype=bool)
    for parcel in parcels:
        footprint = Rectangle(parcel.length_m, parcel.width_m)
        distance_m = footprint.distance_m(sensors_m.reshape(-1, 2), np.array(AT[parcel.name]))
        covered |= distance_m.reshape(covered.shape) < 0
    return (covered @ (1 << np.arange(5))).tolist()


def tracking(*parcels: Parcel, cells: int = LAYOUT.cells) -> Tracker:
    tracker = Tracker(LAYOUT, parcels)
    for cell, bits in enumerate(bits_under(parcels)[:cells], 1):
        tracker.on_presence(0.0, cell, bits)
    for step in range(10):
        tracker.on_speeds(0.01 * step, STILL)
    return tracker


def test_two_parcels_are_told_apart_by_where_they_were_put() -> None:
    tracker = tracking(RIGHT, LEFT)
    for name, pose in AT.items():
        found = tracker.estimate(name, 0.1)
        assert found is not None
        assert np.hypot(found.x_m - pose[0], found.y_m - pose[1]) < 0.03
        assert abs(found.yaw_rad - pose[2]) < 0.15


def test_parcels_that_nearly_touch_are_told_apart() -> None:
    footprint = Rectangle(0.36, 0.30)
    poses = {"west": (-0.19, 0.0, 0.0), "east": (0.19, 0.01, 0.0)}
    parcels = (Parcel("west", 0.36, 0.30, (-0.22, 0.02)), Parcel("east", 0.36, 0.30, (0.22, 0.0)))
    sensors_m = LAYOUT.sensor_positions_m.reshape(-1, 2)
    covered = np.zeros(len(sensors_m), dtype=bool)
    for pose in poses.values():
        covered |= footprint.distance_m(sensors_m, np.array(pose)) < 0
    tracker = Tracker(LAYOUT, parcels)
    for cell, bits in enumerate(covered.reshape(-1, 5) @ (1 << np.arange(5)), 1):
        tracker.on_presence(0.0, cell, int(bits))
    for step in range(20):
        tracker.on_speeds(0.01 * step, STILL)
    for name, pose in poses.items():
        found = tracker.estimate(name, 0.2)
        assert found is not None
        assert np.hypot(found.x_m - pose[0], found.y_m - pose[1]) < 0.03


def test_a_parcel_is_not_found_where_something_else_lies() -> None:
    tracker = Tracker(LAYOUT, (Parcel("plank", 0.9, 0.05),))
    for cell, bits in enumerate(bits_under((LEFT,)), 1):
        tracker.on_presence(0.0, cell, bits)
    # It is looked for everywhere each time.
    for step in range(4):
        tracker.on_speeds(0.01 * step, STILL)
    assert tracker.estimate("plank", 0.04) is None


def test_nothing_is_found_before_every_cell_has_spoken() -> None:
    assert tracking(LEFT, cells=35).estimate("left", 0.1) is None
    assert tracking(LEFT).estimate("left", 0.1) is not None


def test_an_edge_moves_only_the_parcel_that_is_near() -> None:
    tracker = tracking(LEFT, RIGHT)
    before = dict(tracker.poses(0.1))
    footprint, sensors_m = Rectangle(0.25, 0.20), LAYOUT.sensor_positions_m.reshape(-1, 2)
    cell, sensor = divmod(int(np.argmin(abs(footprint.distance_m(sensors_m, before["right"])))), 5)
    tracker.on_presence(0.1, cell + 1, bits_under((LEFT, RIGHT))[cell] ^ 1 << sensor)
    after = tracker.poses(0.1)
    assert (after["left"] == before["left"]).all()
    assert (after["right"] != before["right"]).any()


def test_parcels_move_on_with_their_own_wheels() -> None:
    tracker = tracking(LEFT, RIGHT)
    speeds_m_s = np.where(LAYOUT.wheel_positions_m[:, 0] < 0, 0.1, -0.1)
    speeds_m_s[1::2] = 0.0  # the second wheel of every cell
    before = dict(tracker.poses(0.09))
    for step in (10, 11):
        tracker.on_speeds(0.01 * step, speeds_m_s)
    after = tracker.poses(0.12)
    assert after["left"][0] > before["left"][0]
    assert after["right"][0] < before["right"][0]


def test_an_array_without_parcels_is_tracked_without_a_word() -> None:
    assert tracking().poses(0.1) == {}


def test_parcels_are_looked_for_together_and_all_are_found() -> None:
    tracker = Tracker(LAYOUT, (LEFT, RIGHT))
    for cell, bits in enumerate(bits_under((LEFT, RIGHT)), 1):
        tracker.on_presence(0.0, cell, bits)
    found = [tracker.on_speeds(0.01 * step, STILL) for step in range(10)]
    assert [names for names in found if names] == [["left", "right"]]


def test_sensors_of_cells_that_come_and_go_move_no_belief() -> None:
    tracker = tracking(LEFT)
    before = tracker.estimate("left", 0.1)
    tracker.look_away()
    for cell in range(1, LAYOUT.cells + 1):
        tracker.on_presence(0.15, cell, 0)
    for step in range(20, 200):
        tracker.on_speeds(0.01 * step, STILL)
    assert tracker.estimate("left", 2.0) == before
    assert not tracker.doubtful
    tracker.look_again(0.008)
    tracker.on_speeds(2.0, STILL)
    assert tracker.estimate("left", 2.0) is None


def test_a_parcel_is_still_found_when_its_sensors_count_again() -> None:
    tracker = tracking(LEFT)
    before = tracker.estimate("left", 0.1)
    tracker.look_away()
    for step in range(20, 200):
        tracker.on_speeds(0.01 * step, STILL)
    tracker.look_again(0.008)
    for step in range(200, 230):
        tracker.on_speeds(0.01 * step, STILL)
    after = tracker.estimate("left", 2.3)
    assert after is not None
    assert np.hypot(after.x_m - before.x_m, after.y_m - before.y_m) < 0.005
