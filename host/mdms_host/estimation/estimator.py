"""Where one parcel is and how it moves, from presence bits and wheel speeds alone.

Wheels that roll give the twist; a sensor that changes shows that the parcel's edge is over it.
"""

from math import cos, inf, sin

import numpy as np

from mdms_host.estimation.bottom import Bottom
from mdms_host.estimation.confirmation import Confirmation, Standing
from mdms_host.estimation.feeling import turn_to_feel_rad
from mdms_host.estimation.locate import Location
from mdms_host.estimation.pose_filter import PoseFilter
from mdms_host.estimation.search import Search
from mdms_host.estimation.twist_fit import fit_twist
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats

#: How well an edge is known at the instant a sensor changes.
_EDGE_M = 0.0002
#: A frame comes so long after its edge, give or take as much; the parcel has moved on meanwhile.
_LATENCY_S = 0.002
#: What a sensor shows is judged from this far inside the outline on, or from so many standard
#: deviations of the distance.
_DEEP_M = 0.015
_DEEP_DEVIATIONS = 3.0
#: A sensor that is covered farther beside a parcel shows something else.
_BESIDE_M = 0.06
_LOOK_AGAIN_S = 0.1
_LOOK_ON_S = 0.02
#: A parcel is shown where more of the sensors deep under it are covered.
_COVERED_SHARE = 0.5
#: A pose is carried on without new speeds for so long.
_CARRIED_S = 0.1
#: A larger outline is worked out again from this change on [m].
_GROWN_M = 5e-5
_KEPT_S = 0.5


class ParcelEstimator:
    """Estimate of one parcel's pose and twist [table frame; SI].

    `pose` is (x, y, yaw), or None until the sensors have shown it, and when it is lost;
    `covariance` is of shape (3, 3) and `twist` is (vx, vy, yaw rate). The yaw starts as the one
    nearest to the hint. `acquire` does nothing before `look_s` [s]. `corrected` is set by every
    sensor that is believed, `disbelieved` is of the last search: sensors (S,) that contradict it.
    `bottom` is as large as edges have shown it to be.
    """

    def __init__(self, layout: Layout, bottom: Bottom, yaw_hint_rad: float = 0.0) -> None:
        self._layout = layout
        self._sensors_m = layout.sensor_positions_m.reshape(-1, 2)
        self._yaw_hint_rad = yaw_hint_rad
        self._at_s = 0.0
        self._rolled_s = -inf
        self.look_s = -inf
        self._extent_m = np.array([1.0, 1.0, 1.0 / bottom.reach_m])
        self._drawn = bottom
        self._growth: Floats = np.zeros(2)
        # That of a while ago, and of one more before: what a parcel seems to grow by while it is
        # lifted off is not to be kept.
        self._kept_growths = (self._growth, self._growth)
        self._kept_s = 0.0
        self._filter: PoseFilter | None = None
        self._confirmation = Confirmation()
        self._search: Search | None = None
        self.bottom = bottom
        self.twist: Floats = np.zeros(3)
        self.corrected = False
        self.disbelieved: Bools = np.zeros(len(self._sensors_m), dtype=bool)

    @property
    def standing(self) -> Standing:
        """What the belief is worth."""
        return self._confirmation.standing

    @property
    def pose(self) -> Floats | None:
        """The pose at the last speeds, shape (3,)."""
        return None if self._filter is None else self._filter.mean[:3]

    @property
    def covariance(self) -> Floats:
        """Of the pose, shape (3, 3); zero without one."""
        return np.zeros((3, 3)) if self._filter is None else self._filter.covariance[:3, :3]

    def acquire(self, now_s: float, covered: Bools, mine: Bools) -> bool:
        """Search on for the parcel with the sensors that are its own; True if it was found.

        Both arrays are of shape (S,), S the sensors of all cells in a row. A step of the search
        takes some milliseconds.
        """
        if now_s < self.look_s:
            return False
        search = self._search
        if search is None or (search.covered != covered).any():
            pose = self.pose
            hint_rad = self._yaw_hint_rad if pose is None else float(pose[2])
            search = Search(self.bottom, self._layout, covered.copy(), mine, hint_rad)
        search.step()
        self._search = None if search.over else search
        self.look_s = now_s + (_LOOK_AGAIN_S if search.over else _LOOK_ON_S)
        if not search.over or search.found is None:
            return False
        self.start(now_s, search.found)
        self.disbelieved = self._contradicting(covered, mine) | search.left_out
        return True

    def _contradicting(self, covered: Bools, mine: Bools) -> Bools:
        """Sensors (S,) that contradict a place which has just been found by more than can be."""
        assert self._filter is not None
        distance_m = self.bottom.distance_m(self._sensors_m, self._filter.mean[:3])
        unsure_m = max(_DEEP_M, _DEEP_DEVIATIONS * self._deviation_m)
        wrong: Bools = mine & ((distance_m < 0) != covered) & (abs(distance_m) > unsure_m)
        return wrong

    @property
    def _deviation_m(self) -> float:
        assert self._filter is not None
        return float(np.sqrt(self._filter.covariance[[0, 1], [0, 1]].max()))

    def start(self, now_s: float, found: Location) -> None:
        """Begin from a place, at rest."""
        reach_m = self._drawn.reach_m
        self._filter = PoseFilter(found.pose, found.covariance, reach_m, self._growth)
        self._confirmation.find(now_s)
        self.twist = np.zeros(3)
        self._at_s = now_s
        self._corrected()

    def blur(self, deviation_m: float) -> None:
        """The parcel may have moved by so much unseen, as a standard deviation."""
        if self._filter is not None:
            self._filter.blur(deviation_m)

    def pose_at(self, now_s: float) -> Floats | None:
        """The pose carried on to a time near now by the present twist, for 0.1 s at most."""
        if self._filter is None:
            return None
        pose: Floats = self._filter.mean[:3] + self.twist * min(now_s - self._at_s, _CARRIED_S)
        return pose

    def distance_m(self, now_s: float) -> Floats:
        """Distance of all sensors from the parcel's edge [m], negative inside; inf if unknown."""
        pose = self.pose_at(now_s)
        if pose is None:
            return np.full(len(self._sensors_m), np.inf)
        return self.bottom.distance_m(self._sensors_m, pose)

    def off_m(self, now_s: float, sensor: int) -> float:
        """How far one sensor is from the parcel's edge, whichever side [m]; inf if unknown."""
        pose = self.pose_at(now_s)
        return inf if pose is None else abs(self.bottom.edge(self._sensors_m[sensor], pose)[0])

    def turn_to_feel_rad(self, usable: Bools) -> float | None:
        """The turn that would make the place sure enough [rad]; None where it is, or none does."""
        if self._filter is None:
            return None
        pose, covariance = self._filter.mean[:3], self._filter.covariance[:3, :3]
        return turn_to_feel_rad(self.bottom, self._sensors_m, usable, pose, covariance)

    def predict(
        self,
        now_s: float,
        speed_m_s: Floats,
        known: Bools | None = None,
        standing: Bools | None = None,
    ) -> None:
        """Roll on to the time at which the wheels had these speeds; all arrays of shape (W,).

        Wheels that are not `known` are left out (None: all are); without any under the parcel its
        twist stays for 0.1 s: by then cells that nobody commands have braked. Where all of them are
        `standing` so is the parcel, whatever their speeds.
        """
        if self._filter is None:
            return
        before = self.twist
        step_s = max(0.0, now_s - self._at_s)
        twist = self._fit_twist(self._filter.mean[:3], speed_m_s, known, standing)
        if twist is not None:
            self.twist, self._rolled_s = twist, now_s
        elif now_s > self._rolled_s + _CARRIED_S:
            self.twist = np.zeros(3)
        self._filter.move((before + self.twist) * (step_s / 2), step_s)
        self._at_s = now_s

    def edge(self, now_s: float, sensor: int) -> None:
        """A sensor has just changed: the parcel's edge was over it when the cell saw it."""
        pose = self.pose_at(now_s - _LATENCY_S)
        if self._filter is None or pose is None or self.standing is not Standing.FOUND:
            return
        off_m, slope = self._off(pose, sensor)
        late_m = _LATENCY_S * float(slope[:3] @ self.twist)
        if self._filter.on_edge(off_m, slope, (_EDGE_M**2 + late_m**2) ** 0.5):
            self._corrected()

    def agree(self, now_s: float, covered: Bools, mine: Bools, distance_m: Floats) -> Standing:
        """Correct the estimate by every sensor that contradicts it, as far as that can be.

        All arrays are of shape (S,); `distance_m` is that of now. Nothing corrects an estimate that
        is not `FOUND`; what is lost has no pose any more.
        """
        shown = self._shown(covered, mine, distance_m)
        if shown and self.standing is Standing.FOUND:
            wrong = mine & ((distance_m < 0) != covered) & (distance_m < _BESIDE_M)
            for sensor in wrong.nonzero()[0].tolist():
                shown &= self._bound(now_s, sensor)
        self._confirm(now_s, shown)
        return self.standing

    def _confirm(self, now_s: float, shown: bool) -> None:
        """Take in whether the parcel is shown where it is believed to be."""
        before = self.standing
        if self._confirmation.step(now_s, shown) is Standing.LOST:
            self._lose()
        elif self.standing is not before:
            self._grow(self._kept_growths[1])
        elif self.standing is Standing.FOUND and now_s >= self._kept_s + _KEPT_S:
            self._kept_growths, self._kept_s = (self._growth, self._kept_growths[0]), now_s

    def _lose(self) -> None:
        """Where the parcel is is not known any more."""
        if self._filter is not None:
            self._yaw_hint_rad = float(self._filter.mean[2])
        self._filter = None
        self.twist = np.zeros(3)

    def _shown(self, covered: Bools, mine: Bools, distance_m: Floats) -> bool:
        """Whether most of the sensors that lie deep under the parcel are covered."""
        if self._filter is None:
            return False
        deep = mine & (distance_m < -max(_DEEP_M, _DEEP_DEVIATIONS * self._deviation_m))
        if not deep.any():
            deep = mine & (distance_m < 0)
        return bool((deep & covered).sum() > _COVERED_SHARE * deep.sum())

    def _fit_twist(
        self, pose: Floats, speed_m_s: Floats, known: Bools | None, standing: Bools | None
    ) -> Floats | None:
        """Rigid twist that most wheels under the parcel agree on, shape (3,).

        Zero without any under it, None where none of them is known.
        """
        under = self.bottom.distance_m(self._layout.wheel_positions_m, pose) < 0
        if known is not None and under.any():
            under &= known
            if not under.any():
                return None
        if not under.any() or (standing is not None and standing[under].all()):
            return np.zeros(3)
        # Columns in metres per second alike, so that what no wheel shows comes out as zero.
        jacobian = self._layout.surface_jacobian(*pose[:2].tolist()) * self._extent_m
        vx, vy, corner_m_s = (self.twist / self._extent_m).tolist()
        fit = fit_twist(jacobian[under], speed_m_s[under], (vx, vy, corner_m_s))
        twist: Floats = np.array(fit) * self._extent_m
        return twist

    def _bound(self, now_s: float, sensor: int) -> bool:
        """A sensor is on the other side of the edge; False if that cannot be believed."""
        pose = self.pose_at(now_s)
        if self._filter is None or pose is None:
            return True
        off_m, slope = self._off(pose, sensor)
        late_m = 2 * _LATENCY_S * float(slope[:3] @ self.twist)
        believed = self._filter.on_bound(off_m, slope, (_EDGE_M**2 + late_m**2) ** 0.5)
        if believed:
            self._corrected()
        return believed

    def _off(self, pose: Floats, sensor: int) -> tuple[float, Floats]:
        """Distance of a sensor from the edge [m], and its derivative by pose and growth, (5,)."""
        off_m, slope = self.bottom.edge(self._sensors_m[sensor], pose)
        x, y, _ = slope.tolist()
        cosine, sine = cos(pose[2]), sin(pose[2])
        along, across = cosine * x + sine * y, cosine * y - sine * x
        return off_m, np.array([*slope, -along * along, -across * across])

    def _corrected(self) -> None:
        self.corrected = True
        assert self._filter is not None
        growth = self._filter.mean[3:]
        if abs(growth - self._growth).max() > _GROWN_M:
            self._grow(growth.copy())

    def _grow(self, growth: Floats) -> None:
        self._growth = growth
        self.bottom = self._drawn.grown(*growth.tolist())
