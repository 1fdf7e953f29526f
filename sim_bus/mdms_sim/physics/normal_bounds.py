"""Least and greatest normal forces under a parcel, over all places it may have on a large array."""

import math
from dataclasses import dataclass

import numpy as np

from mdms_sim.physics.supports import press
from mdms_sim.record import Floats
from mdms_sim.scenario import Parcel, Scenario, ScenarioError

PLACES = 48
"""Places searched along each axis of one pitch."""


@dataclass(frozen=True, slots=True)
class NormalBounds:
    """How many wheels carry a parcel, and how much each [N], over all its poses."""

    supports_min: int
    supports_max: int
    normal_min_n: float
    normal_max_n: float


def search_normals(scenario: Scenario, parcel: Parcel) -> NormalBounds:
    """The bounds over the poses in which the parcel stands.

    Raises `ScenarioError` where it stands in none.
    """
    pitch_m = scenario.array.pitch_m
    shifts_m = (np.arange(PLACES) + 0.5) / PLACES * pitch_m
    across_m = shifts_m if scenario.array.rows > 1 else np.array([parcel.y_m])
    found = [normals_at(scenario, parcel, x_m, y_m) for x_m in shifts_m for y_m in across_m]
    standing = [normal_n for normal_n in found if normal_n is not None]
    if not standing:
        raise ScenarioError(
            f"parcel {parcel.name!r} tips wherever it lies; "
            f"its centre of mass needs wheels around it, {pitch_m} m apart"
        )
    carrying = [int((normal_n > 0.0).sum()) for normal_n in standing]
    return NormalBounds(
        supports_min=min(carrying),
        supports_max=max(carrying),
        normal_min_n=min(float(normal_n.min()) for normal_n in standing),
        normal_max_n=max(float(normal_n.max()) for normal_n in standing),
    )


def centred_normal_n(scenario: Scenario, parcel: Parcel) -> float:
    """Greatest normal force under a parcel with its centre at the array's origin [N]."""
    array = scenario.array
    middle_m = array.pitch_m * (1 - array.columns % 2) / 2
    across_m = array.pitch_m * (1 - array.rows % 2) / 2
    normal_n = normals_at(scenario, parcel, middle_m, across_m)
    return math.inf if normal_n is None else float(normal_n.max())


def normals_at(scenario: Scenario, parcel: Parcel, x_m: float, y_m: float) -> Floats | None:
    """Normal forces of all covered wheels, the parcel `x_m`, `y_m` from a cell; None: it tips."""
    cosine, sine = math.cos(parcel.yaw_rad), math.sin(parcel.yaw_rad)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    own_m = (wheel_places_m(scenario, parcel) - (x_m, y_m)) @ turn.T
    half_m = np.array([parcel.length_m, parcel.width_m]) / 2 + 1e-12
    under = (abs(own_m) <= half_m).all(axis=1)
    spot_m = own_m[under] - parcel.centre_of_mass_m
    normal_n = np.empty(len(spot_m))
    weight_n = parcel.mass_kg * scenario.run.gravity_m_s2
    return normal_n if press(spot_m, weight_n, normal_n) else None


def wheel_places_m(scenario: Scenario, parcel: Parcel) -> Floats:
    """Wheels (W, 2) of an array that reaches far around a cell at the origin [m]."""
    array = scenario.array
    reach = math.ceil(math.hypot(parcel.length_m, parcel.width_m) / array.pitch_m) + 2
    steps = np.arange(-reach, reach + 1) * array.pitch_m
    rows = steps if array.rows > 1 else np.zeros(1)
    cells = np.array([(x_m, y_m) for x_m in steps for y_m in rows])
    offsets = np.array([wheel.offset_m for wheel in scenario.cell.wheel])
    wheels: Floats = (cells[:, np.newaxis] + offsets).reshape(-1, 2)
    return wheels
