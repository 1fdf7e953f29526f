"""Where cells and wheels are on the table, as the scenario places them [m; table frame]."""

from math import cos, sin

import numpy as np

from mdms_sim.record import Floats
from mdms_sim.scenario import Goal, Parcel, Scenario


def is_row(scenario: Scenario) -> bool:
    """Whether all there is to see is position along one line: a row of wheels that push along x."""
    return scenario.array.rows == 1 and all(
        abs(sin(wheel.direction_rad)) < 1e-9 for wheel in scenario.cell.wheel
    )


def cell_centres_m(scenario: Scenario) -> Floats:
    """Centres of all cells in the order of their numbers, shape (cells, 2)."""
    array = scenario.array
    x_m = (np.arange(array.columns) - (array.columns - 1) / 2) * array.pitch_m
    y_m = (np.arange(array.rows) - (array.rows - 1) / 2) * array.pitch_m
    return np.stack(np.meshgrid(x_m, y_m), axis=-1).reshape(-1, 2)


def wheel_places_m(scenario: Scenario) -> Floats:
    """Contact points of all wheels in the order of a record, shape (W, 2)."""
    offsets_m = np.array([wheel.offset_m for wheel in scenario.cell.wheel])
    places_m: Floats = cell_centres_m(scenario)[:, None, :] + offsets_m
    return places_m.reshape(-1, 2)


def wheel_directions(scenario: Scenario) -> Floats:
    """Unit vectors along which the wheels push, shape (W, 2)."""
    turns = [wheel.direction_rad for wheel in scenario.cell.wheel]
    one_cell = np.array([(cos(turn), sin(turn)) for turn in turns])
    return np.tile(one_cell, (scenario.array.columns * scenario.array.rows, 1))


def goal_of(scenario: Scenario, parcel: Parcel) -> Goal | None:
    """Where a parcel is steered to, if the motion steers at all."""
    return parcel.goal if scenario.motion.field == "goal" else None


def outline_m(pose: Floats, length_m: float, width_m: float) -> Floats:
    """Corners of a rectangle at a pose (x, y, yaw), counter-clockwise, shape (4, 2)."""
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (length_m / 2, width_m / 2)
    turned = np.array([[cos(pose[2]), sin(pose[2])], [-sin(pose[2]), cos(pose[2])]])
    corners_m: Floats = corners @ turned + pose[:2]
    return corners_m
