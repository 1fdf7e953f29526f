"""Which sensors belong to which parcel, and the estimates of all parcels."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import inf

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.bottom import Bottom
from mdms_host.estimation.confirmation import Standing
from mdms_host.estimation.disc import Disc
from mdms_host.estimation.estimator import ParcelEstimator
from mdms_host.estimation.polygon import Polygon
from mdms_host.estimation.presence_map import PresenceMap
from mdms_host.estimation.rectangle import Rectangle
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats, Ints

#: A parcel that was lifted may be set down at such a distance from any other, or farther [m].
_ELSEWHERE_M = 0.03
#: A parcel must stand still this long before it is searched for.
_STILL_S = 0.05


@dataclass(frozen=True, slots=True)
class Parcel:
    """A parcel as given to the host: its outline, and roughly where it was put.

    `near_m` distinguishes parcels when there are several; the yaw starts as the one that looks the
    same and is nearest to `yaw_hint_rad`. `corners_m` are those of the shape 'polygon', in its own
    frame, and `length_m` is the diameter of a 'disc'.
    """

    name: str
    length_m: float
    width_m: float
    near_m: tuple[float, float] | None = None
    yaw_hint_rad: float = 0.0
    shape: str = "rectangle"
    corners_m: tuple[tuple[float, float], ...] = ()

    @property
    def bottom(self) -> Bottom:
        """The outline that the wheels and sensors are under."""
        if self.shape == "disc":
            return Disc(self.length_m)
        if self.shape == "polygon":
            return Polygon(self.corners_m)
        return Rectangle(self.length_m, self.width_m)


@dataclass(frozen=True, slots=True)
class Estimate:
    """Believed pose of a parcel [m, m, rad; table frame]."""

    x_m: float
    y_m: float
    yaw_rad: float


class Tracker:
    """Estimates of all parcels on the array, fed with presence bits and wheel speeds.

    What a cell has not repeated for three of the periods in which it does shows nothing any more.
    `debounce_s` is how long each cell waits before it reports a change (none: not at all).
    Raises ValueError if there are several parcels and `near_m` of one is missing.
    """

    def __init__(
        self,
        layout: Layout,
        parcels: tuple[Parcel, ...],
        status_period_s: float = inf,
        debounce_s: tuple[float, ...] = (),
    ) -> None:
        unplaced = [parcel.name for parcel in parcels if parcel.near_m is None]
        if len(parcels) > 1 and unplaced:
            raise ValueError(
                f"{len(parcels)} parcels can be told apart only by where they were put; "
                f"near_m is missing for {', '.join(unplaced)}"
            )
        self._sensors_m = layout.sensor_positions_m.reshape(-1, 2)
        self._presence = PresenceMap(
            layout.cells, len(layout.sensor_offsets_m), status_period_s, debounce_s
        )
        self._faulty: list[tuple[int, list[int]]] = []
        self._expected_m = {
            parcel.name: _expected_distance_m(parcel, self._sensors_m) for parcel in parcels
        }
        self._standings = dict.fromkeys(self._expected_m, Standing.LOST)
        self._estimators = {
            parcel.name: ParcelEstimator(layout, parcel.bottom, parcel.yaw_hint_rad)
            for parcel in parcels
        }

    def on_presence(self, now_s: float, cell: int, bits: int) -> None:
        """Cell `cell` (from 1) reports which of its sensors are covered: bit k sensor k."""
        for time_s, sensor in self._presence.on_report(now_s, cell, bits):
            self._on_edge(time_s, sensor)

    def ignore_cells(self, cells: Collection[int]) -> None:
        """The sensors of these cells (from 1) show nothing from now on, those of all others do."""
        self._presence.ignore(cells)

    def blur(self, deviation_m: float) -> None:
        """Parcels may have moved by so much unseen: sensors that differ are to be believed."""
        for estimator in self._estimators.values():
            estimator.blur(deviation_m)

    def on_speeds(
        self,
        now_s: float,
        speed_m_s: Floats,
        known: Bools | None = None,
        standing: Bools | None = None,
    ) -> list[str]:
        """Wheels, shape (W,), had these speeds at that time; returns parcels found by that.

        The speeds of all wheels are `known` if that is None; `standing` are wheels that are to
        stand, and do but for the noise of their encoders.
        """
        for estimator in self._estimators.values():
            estimator.predict(now_s, speed_m_s, known, standing)
        found = self._find_missing(now_s)
        distances_m = self._distances_m(now_s)
        owners = self._owners(distances_m)
        covered, valid = self._presence.covered, self._presence.valid(now_s)
        for number, (name, estimator) in enumerate(self._estimators.items()):
            if estimator.standing is Standing.FOUND:
                self._expected_m[name] = distances_m[number]
            if estimator.pose is not None:
                mine = valid & (owners == number)
                estimator.agree(now_s, covered, mine, distances_m[number])
        if distances_m and not self.unconfirmed:
            self._faulty += self._presence.judge(now_s, np.min(distances_m, axis=0))
        return found

    def take_faulty(self) -> list[tuple[int, list[int]]]:
        """Cells (from 1) with sensors (from 0) that contradict all others, since the last call."""
        faulty, self._faulty = self._faulty, []
        return faulty

    def take_changes(self) -> list[tuple[str, Standing]]:
        """Parcels that have been found, or become doubtful or lost, since the last call."""
        changes = [
            (name, one.standing)
            for name, one in self._estimators.items()
            if one.standing is not self._standings[name]
        ]
        self._standings.update(changes)
        return changes

    def beliefs(self, at_s: float, now_s: float, near: Collection[str] = ()) -> dict[str, Belief]:
        """What is believed, at a time near now, of every parcel that has a pose, by name.

        `near` are parcels about to arrive: theirs say by which turn they would be known better.
        """
        believed = {}
        valid = self._presence.valid(now_s)
        for name, one in self._estimators.items():
            pose = one.pose_at(at_s)
            if pose is not None:
                believed[name] = Belief(
                    name,
                    one.bottom,
                    pose,
                    one.twist,
                    one.covariance,
                    one.standing,
                    one.corrected,
                    one.turn_to_feel_rad(valid) if name in near else None,
                )
            one.corrected = False
        return believed

    def estimate(self, name: str, now_s: float) -> Estimate | None:
        """Where the parcel is believed to be; None as long as it has not been found."""
        pose = self._estimators[name].pose_at(now_s)
        return None if pose is None else Estimate(*map(float, pose))

    def poses(self, now_s: float) -> Mapping[str, Floats]:
        """Pose (x, y, yaw) of every parcel that has been found."""
        found = ((name, one.pose_at(now_s)) for name, one in self._estimators.items())
        return {name: pose for name, pose in found if pose is not None}

    def covariance(self, name: str) -> Floats:
        """What the pose of a parcel may be off, shape (3, 3); zero where it is not found."""
        return self._estimators[name].covariance

    @property
    def doubtful(self) -> set[str]:
        """Parcels that sensors do not show where they are believed to be."""
        return {n for n, one in self._estimators.items() if one.standing is Standing.DOUBTFUL}

    @property
    def unconfirmed(self) -> bool:
        """Whether any parcel is not found."""
        return any(one.standing is not Standing.FOUND for one in self._estimators.values())

    def _on_edge(self, now_s: float, sensor: int) -> None:
        """The parcel whose edge is nearest to the sensor has crossed it."""
        if self._estimators:
            estimators = self._estimators.values()
            min(estimators, key=lambda one: one.off_m(now_s, sensor)).edge(now_s, sensor)

    def _distances_m(self, now_s: float) -> list[Floats]:
        """Distance of all sensors from each parcel, or from where it was last, shape (S,).

        Sensors farther away than `_ELSEWHERE_M` from those that are found may show any other.
        """
        return [
            one.distance_m(now_s)
            if one.standing is Standing.FOUND
            else _beyond(self._expected_m[name])
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
        presence = self._presence
        if not presence.complete or now_s < presence.changed_s + _STILL_S:
            return []
        for number, (name, one) in enumerate(self._estimators.items()):
            if one.standing is not Standing.FOUND and now_s >= one.look_s:
                mine = presence.valid(now_s) & (self._owners(self._distances_m(now_s)) == number)
                if not one.acquire(now_s, presence.covered, mine):
                    return []
                self._faulty += presence.disbelieve(one.disbelieved)
                return [name]
        return []


def _beyond(distance_m: Floats) -> Floats:
    """Distances in their order, but those beyond `_ELSEWHERE_M` nearly alike."""
    return np.minimum(distance_m, _ELSEWHERE_M + 1e-3 * (distance_m - _ELSEWHERE_M))


def _expected_distance_m(parcel: Parcel, sensors_m: Floats) -> Floats:
    """Distance of the sensors from the parcel where it was put [m]; zero if that is not given."""
    if parcel.near_m is None:
        return np.zeros(len(sensors_m))
    return parcel.bottom.distance_m(sensors_m, np.array([*parcel.near_m, parcel.yaw_hint_rad]))
