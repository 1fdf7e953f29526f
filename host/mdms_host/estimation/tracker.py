"""Which sensors belong to which parcel, and the estimates of all parcels."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

import numpy as np

from mdms_host.estimation.estimator import ParcelEstimator
from mdms_host.estimation.rectangle import Rectangle
from mdms_host.layout import Layout
from mdms_model.arrays import Floats, Ints

#: A parcel must stand still this long before it is searched for.
_STILL_S = 0.05


@dataclass(frozen=True, slots=True)
class Parcel:
    """A parcel as given to the host: its size, and roughly where it was put.

    `near_m` distinguishes parcels when there are several; the yaw starts as the one that looks the
    same and is nearest to `yaw_hint_rad`.
    """

    name: str
    length_m: float
    width_m: float
    near_m: tuple[float, float] | None = None
    yaw_hint_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Estimate:
    """Believed pose of a parcel [m, m, rad; table frame]."""

    x_m: float
    y_m: float
    yaw_rad: float


class Tracker:
    """Estimates of all parcels on the array, fed with presence bits and wheel speeds.

    Raises ValueError if there are several parcels and `near_m` of one is missing.
    """

    def __init__(self, layout: Layout, parcels: tuple[Parcel, ...]) -> None:
        unplaced = [parcel.name for parcel in parcels if parcel.near_m is None]
        if len(parcels) > 1 and unplaced:
            raise ValueError(
                f"{len(parcels)} parcels can be told apart only by where they were put; "
                f"near_m is missing for {', '.join(unplaced)}"
            )
        self._sensors_m = layout.sensor_positions_m.reshape(-1, 2)
        self._sensors_per_cell = len(layout.sensor_offsets_m)
        self._bits: list[int | None] = [None] * layout.cells
        self._covered = np.zeros(len(self._sensors_m), dtype=bool)
        self._changed_s = -inf
        self._expected_m = {
            parcel.name: _expected_distance_m(parcel, self._sensors_m) for parcel in parcels
        }
        self._estimators = {
            parcel.name: ParcelEstimator(
                layout, Rectangle(parcel.length_m, parcel.width_m), parcel.yaw_hint_rad
            )
            for parcel in parcels
        }

    def on_presence(self, now_s: float, cell: int, bits: int) -> None:
        """Cell `cell` (from 1) reports which of its sensors are covered: bit k sensor k."""
        before, bits = self._bits[cell - 1], bits & (1 << self._sensors_per_cell) - 1
        if bits == before:
            return
        self._bits[cell - 1], self._changed_s = bits, now_s
        first = (cell - 1) * self._sensors_per_cell
        for place in range(self._sensors_per_cell):
            self._covered[first + place] = bits >> place & 1
            if before is not None and (bits ^ before) >> place & 1:
                self._on_edge(now_s, first + place)

    def on_speeds(self, now_s: float, speed_m_s: Floats) -> list[str]:
        """All wheels, shape (W,), had these speeds at that time; returns parcels found by that."""
        for estimator in self._estimators.values():
            estimator.predict(now_s, speed_m_s)
        found = self._find_missing(now_s)
        distances_m = self._distances_m(now_s)
        owners = self._owners(distances_m)
        for number, estimator in enumerate(self._estimators.values()):
            if estimator.pose is not None:
                estimator.agree(now_s, self._covered, owners == number, distances_m[number])
        return found

    def estimate(self, name: str, now_s: float) -> Estimate | None:
        """Where the parcel is believed to be; None as long as it has not been found."""
        pose = self._estimators[name].pose_at(now_s)
        return None if pose is None else Estimate(*map(float, pose))

    def poses(self, now_s: float) -> Mapping[str, Floats]:
        """Pose (x, y, yaw) of every parcel that has been found."""
        found = ((name, one.pose_at(now_s)) for name, one in self._estimators.items())
        return {name: pose for name, pose in found if pose is not None}

    def _on_edge(self, now_s: float, sensor: int) -> None:
        """The parcel whose edge is nearest to the sensor has crossed it."""
        if self._estimators:
            estimators = self._estimators.values()
            min(estimators, key=lambda one: one.off_m(now_s, sensor)).edge(now_s, sensor)

    def _distances_m(self, now_s: float) -> list[Floats]:
        """Distance of all sensors from each parcel, or from where it was put, shape (S,)."""
        return [
            self._expected_m[name] if one.pose is None else one.distance_m(now_s)
            for name, one in self._estimators.items()
        ]

    def _owners(self, distances_m: list[Floats]) -> Ints:
        """Number of the parcel that each sensor is nearest to, shape (S,)."""
        if len(distances_m) < 2:
            return np.zeros(len(self._sensors_m), dtype=np.intp)
        return np.asarray(np.argmin(distances_m, axis=0))

    def _find_missing(self, now_s: float) -> list[str]:
        """Search for a parcel not found yet, once all cells have reported and nothing moves.

        Only for one, since a search takes milliseconds and setpoints wait meanwhile.
        """
        if None in self._bits or now_s < self._changed_s + _STILL_S:
            return []
        for number, (name, one) in enumerate(self._estimators.items()):
            if one.pose is None and now_s >= one.look_s:
                owners = self._owners(self._distances_m(now_s))
                return [name] if one.acquire(now_s, self._covered, owners == number) else []
        return []


def _expected_distance_m(parcel: Parcel, sensors_m: Floats) -> Floats:
    """Distance of the sensors from the parcel where it was put [m]; zero if that is not given."""
    if parcel.near_m is None:
        return np.zeros(len(sensors_m))
    bottom = Rectangle(parcel.length_m, parcel.width_m)
    return bottom.distance_m(sensors_m, np.array([*parcel.near_m, parcel.yaw_hint_rad]))
