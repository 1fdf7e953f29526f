"""Closed-loop steering of one parcel to a goal pose, gently enough that its wheels roll."""

from dataclasses import dataclass
from math import hypot, inf, pi, sqrt

import numpy as np

from mdms_model.arrays import Floats

#: A parcel is about to be at its goal within so many tolerances.
_NEAR = 5.0
#: So often a parcel turns to have its place made sure; a goal without a yaw is where it is then.
_TURNS = 3


@dataclass(frozen=True, slots=True)
class Goal:
    """The pose that a parcel is steered to [table frame], and when it counts as reached.

    `yaw_rad` None leaves the parcel turned as it is.
    """

    x_m: float
    y_m: float
    yaw_rad: float | None = 0.0
    tolerance_m: float = 0.002
    tolerance_rad: float = 0.01
    settle_s: float = 0.3


@dataclass(frozen=True, slots=True)
class Limits:
    """How fast a parcel may be moved.

    `speed_m_s` bounds the speed of its centre and of its corners' turning together; the
    acceleration takes at most `friction_share` of what friction can give (mu g).
    """

    speed_m_s: float = 0.1
    friction: float = 0.3
    friction_share: float = 0.15
    gravity_m_s2: float = 9.81
    stiffness_per_s: float = 3.0

    @property
    def acceleration_m_s2(self) -> float:
        """Greatest acceleration [m/s2] at which wheels are taken to roll."""
        return self.friction_share * self.friction * self.gravity_m_s2


class GoalController:
    """From a pose to the twist that takes it to the goal; `arrived` once it is there.

    Translation and rotation are one motion: yaw counts by the way of the corners, `reach_m` from
    the centre, so that both end together. A parcel that has arrived is held until a sensor shows it
    outside twice the tolerance; one that is `stopped` is not steered any more, and one that is
    `paused` is brought to rest meanwhile. A place is not sure enough while a turn by `feel_rad`
    would show it better: a parcel there turns so first, three times at most, and back; `leg` counts
    these ways.
    """

    def __init__(self, goal: Goal, limits: Limits, reach_m: float) -> None:
        self.goal = goal
        self.arrived = False
        self.stopped = False
        self.paused = False
        self.feel_rad: float | None = None
        self._turned_rad: float | None = None
        self._turns = 0
        self.leg = 0
        self._limits = limits
        self._reach_m = reach_m
        self._extent_m = np.array([1.0, 1.0, reach_m])
        self._twist_m_s: Floats = np.zeros(3)
        self._left_m = inf
        self._within_s = 0.0

    def go_over_from(self, other: "GoalController") -> None:
        """Begin with the motion that another controller has commanded last."""
        self._twist_m_s = other._twist_m_s
        self.paused = other.paused

    @property
    def left_m(self) -> float:
        """What was left to go at the last step, a corner's way included [m]; inf before it."""
        return self._left_m

    @property
    def near(self) -> bool:
        """Whether the parcel is at its goal, or about to be."""
        return self._left_m <= _NEAR * self.goal.tolerance_m or self._turned_rad is not None

    @property
    def speed_m_s(self) -> float:
        """How fast the parcel is commanded to go there, a corner's way included [m/s]."""
        return hypot(*self._twist_m_s.tolist())

    @property
    def stopping_s(self) -> float:
        """How long it takes to come to rest from the commanded speed [s]."""
        return self.speed_m_s / self._limits.acceleration_m_s2

    def stop(self) -> None:
        """Bring the parcel to rest, and do not steer it any more."""
        self.stopped = True

    def lose(self) -> None:
        """Where the parcel is is not known: it is not steered, and begins anew from rest."""
        self.arrived, self._within_s, self._left_m = False, 0.0, inf
        self._twist_m_s = np.zeros(3)
        self._turned_rad, self._turns = None, 0

    def step(self, pose: Floats, step_s: float, contradicted: bool = True) -> Floats:
        """Twist (vx, vy, yaw rate) to command for the next step, shape (3,), about the centre.

        `contradicted` is whether a sensor has corrected the pose since the last step.
        """
        error_m = self._error_m(pose)
        self._left_m = hypot(*error_m.tolist())
        if contradicted or not self.arrived:
            self._check_arrival(error_m, float(pose[2]), step_s)
        still = self.stopped or self.paused or self.arrived
        wanted_m_s = np.zeros(3) if still else self._approach(error_m)
        change_m_s = wanted_m_s - self._twist_m_s
        most_m_s = self._limits.acceleration_m_s2 * step_s
        size_m_s = hypot(*change_m_s.tolist())
        self._twist_m_s = self._twist_m_s + change_m_s * min(1.0, most_m_s / max(size_m_s, 1e-12))
        twist: Floats = self._twist_m_s / self._extent_m
        return twist

    def _error_m(self, pose: Floats) -> Floats:
        """What is left to go, shape (3,); yaw as the way of a corner [m]."""
        x_m, y_m, yaw_rad = pose.tolist()
        left_rad = 0.0
        wanted_rad = self.goal.yaw_rad if self._turned_rad is None else self._turned_rad
        if wanted_rad is not None:
            left_rad = (wanted_rad - yaw_rad + pi) % (2 * pi) - pi
        return np.array([self.goal.x_m - x_m, self.goal.y_m - y_m, left_rad * self._reach_m])

    def _approach(self, error_m: Floats) -> Floats:
        """Straight to the goal, slowing down as braking demands [m/s], shape (3,)."""
        way_m = max(hypot(*error_m.tolist()), 1e-12)
        braking_m_s = sqrt(self._limits.acceleration_m_s2 * way_m)
        speed_m_s = min(self._limits.speed_m_s, self._limits.stiffness_per_s * way_m, braking_m_s)
        return error_m * (speed_m_s / way_m)

    def _check_arrival(self, error_m: Floats, yaw_rad: float, step_s: float) -> None:
        """Arrived after a while within the tolerance; gone again outside twice of it."""
        slack = 2.0 if self.arrived else 1.0
        x_m, y_m, corner_m = error_m.tolist()
        within = (
            hypot(x_m, y_m) <= slack * self.goal.tolerance_m
            and abs(corner_m) <= slack * self.goal.tolerance_rad * self._reach_m
        )
        self._within_s = self._within_s + step_s if within else 0.0
        self._feel(yaw_rad, settled=self._within_s >= self.goal.settle_s)
        within &= self._turned_rad is None
        self.arrived = within and (self.arrived or self._within_s >= self.goal.settle_s)

    def _feel(self, yaw_rad: float, settled: bool) -> None:
        """Turn away from the goal while that shows the place better, and back when it is sure."""
        if self.feel_rad is None or (settled and self._turns >= _TURNS):
            if self._turned_rad is not None:
                self._turned_rad, self._within_s = None, 0.0
                self.leg += 1
        elif settled and not self.arrived:
            self._turned_rad, self._within_s = yaw_rad + self.feel_rad, 0.0
            self._turns += 1
            self.leg += 1
