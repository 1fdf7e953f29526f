"""Where one parcel is and how it moves, from presence bits and wheel speeds alone.

Wheels that roll give the twist; a sensor that changes shows that the parcel's edge is over it.
The two meet in an extended Kalman filter over the pose (x, y, yaw).
"""

from math import hypot, inf

import numpy as np

from mdms_host.estimation.locate import locate
from mdms_host.estimation.rectangle import Rectangle
from mdms_host.estimation.twist_fit import fit_twist
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats

#: How well an edge is known at the instant a sensor changes, and while one contradicts.
_EDGE_M = 0.0015
_CONTRADICTION_M = 0.004
#: A frame may be this late; the parcel has moved on meanwhile.
_LATENCY_S = 0.005
#: A contradiction this many standard deviations away is not believed.
_GATE = 5.0
#: This many unbelievable sensors mean that the parcel was lost.
_LOST_SENSORS = 3
_LOOK_AGAIN_S = 0.1
#: A place that leaves more of the covered sensors unexplained is not believed.
_DOUBTFUL_SHARE = 0.2
#: Odometry errs by this share of the way, and by this much at rest in a second.
_SLIP_SHARE = 0.1
_DRIFT_M2_S = 1e-8


class ParcelEstimator:
    """Estimate of one rectangular parcel's pose and twist [table frame; SI].

    `pose` is (x, y, yaw), or None until the sensors have shown it; `covariance` is of shape (3, 3)
    and `twist` is (vx, vy, yaw rate). The yaw starts as the one nearest to the hint. `acquire` does
    nothing before `look_s` [s].
    """

    def __init__(self, layout: Layout, rectangle: Rectangle, yaw_hint_rad: float = 0.0) -> None:
        self._layout = layout
        self._sensors_m = layout.sensor_positions_m.reshape(-1, 2)
        self._yaw_hint_rad = yaw_hint_rad
        self._at_s = 0.0
        self.look_s = -inf
        self._extent_m = np.array([1.0, 1.0, 1.0 / rectangle.reach_m])
        self._spread_m2 = np.diag(self._extent_m**2)
        self.rectangle = rectangle
        self.pose: Floats | None = None
        self.covariance: Floats = np.zeros((3, 3))
        self.twist: Floats = np.zeros(3)

    def acquire(self, now_s: float, covered: Bools, mine: Bools) -> bool:
        """Search for the parcel with the sensors that are its own; True if it was found.

        Both arrays are of shape (S,), S the sensors of all cells in a row. A search takes
        some milliseconds, so it is not repeated at once.
        """
        if now_s < self.look_s:
            return False
        self.look_s = now_s + _LOOK_AGAIN_S
        found = locate(self.rectangle, self._sensors_m[mine], covered[mine], self._yaw_hint_rad)
        if found is None or found.contradictions > _DOUBTFUL_SHARE * (covered & mine).sum():
            return False
        self.pose, self.covariance = found.pose, found.covariance
        self.twist = np.zeros(3)
        self._at_s = now_s
        return True

    def pose_at(self, now_s: float) -> Floats | None:
        """The pose carried on to a time near now by the present twist."""
        if self.pose is None:
            return None
        return self.pose + self.twist * (now_s - self._at_s)

    def distance_m(self, now_s: float) -> Floats:
        """Distance of all sensors from the parcel's edge [m], negative inside; inf if unknown."""
        pose = self.pose_at(now_s)
        if pose is None:
            return np.full(len(self._sensors_m), np.inf)
        return self.rectangle.distance_m(self._sensors_m, pose)

    def off_m(self, now_s: float, sensor: int) -> float:
        """How far one sensor is from the parcel's edge, whichever side [m]; inf if unknown."""
        pose = self.pose_at(now_s)
        return inf if pose is None else abs(self.rectangle.edge(self._sensors_m[sensor], pose)[0])

    def predict(self, now_s: float, speed_m_s: Floats) -> None:
        """Roll on to the time at which the wheels had these speeds, shape (W,)."""
        if self.pose is None:
            return
        before = self.twist
        step_s = max(0.0, now_s - self._at_s)
        self.twist = self._fit_twist(self.pose, speed_m_s)
        moved = (before + self.twist) * (step_s / 2)
        self.pose = self.pose + moved
        x_m, y_m, yaw_rad = moved.tolist()
        way_m = hypot(x_m, y_m) + abs(yaw_rad) * self.rectangle.reach_m
        # The error of odometry grows as a random walk whose steps are a millimetre or so long.
        variance_m2 = _SLIP_SHARE**2 * way_m * 0.01 + _DRIFT_M2_S * step_s
        self.covariance = self.covariance + variance_m2 * self._spread_m2
        self._at_s = now_s

    def edge(self, now_s: float, sensor: int) -> None:
        """A sensor has just changed: the parcel's edge is over it."""
        self._correct(now_s, sensor, _EDGE_M)

    def agree(self, now_s: float, covered: Bools, mine: Bools, distance_m: Floats) -> None:
        """Correct the estimate by every sensor that contradicts it; search again if many are off.

        All arrays are of shape (S,); `distance_m` is that of now.
        """
        wrong = mine & ((distance_m < 0) != covered)
        rejected = [
            sensor
            for sensor in wrong.nonzero()[0].tolist()
            if not self._correct(now_s, sensor, _CONTRADICTION_M)
        ]
        if len(rejected) >= _LOST_SENSORS:
            assert self.pose is not None
            self._yaw_hint_rad = float(self.pose[2])
            self.acquire(now_s, covered, mine)

    def _fit_twist(self, pose: Floats, speed_m_s: Floats) -> Floats:
        """Rigid twist that most wheels under the parcel agree on; zero without any, shape (3,)."""
        under = self.rectangle.distance_m(self._layout.wheel_positions_m, pose) < 0
        if not under.any():
            return np.zeros(3)
        # Columns in metres per second alike, so that what no wheel shows comes out as zero.
        jacobian = self._layout.surface_jacobian(*pose[:2].tolist()) * self._extent_m
        vx, vy, corner_m_s = (self.twist / self._extent_m).tolist()
        fit = fit_twist(jacobian[under], speed_m_s[under], (vx, vy, corner_m_s))
        twist: Floats = np.array(fit) * self._extent_m
        return twist

    def _correct(self, now_s: float, sensor: int, sigma_m: float) -> bool:
        """Kalman update by 'the edge is at this sensor'; False if that cannot be believed."""
        pose = self.pose_at(now_s)
        if self.pose is None or pose is None:
            return True
        off_m, slope = self.rectangle.edge(self._sensors_m[sensor], pose)
        late_m = _LATENCY_S * float(slope @ self.twist)
        spread = self.covariance @ slope
        variance_m2 = float(slope @ spread) + sigma_m**2 + late_m**2
        if off_m**2 > _GATE**2 * variance_m2:
            return False
        gain = spread / variance_m2
        self.pose = self.pose - gain * off_m
        self.covariance = self.covariance - np.outer(gain, spread)
        return True
