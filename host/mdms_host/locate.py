"""Where a parcel lies, judged from nothing but which presence sensors it covers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mdms_host.rectangle import Rectangle

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Fineness of the search: how far a neighbouring candidate is.
_STEP_M = 0.006
_YAW_STEP_RAD = np.radians(3.0)
#: How far the true yaw is from the hint, as a rule.
_HINT_RAD = 0.5


@dataclass(frozen=True, slots=True)
class Location:
    """Mean pose (x, y, yaw) of what the sensors allow, its covariance, and how many disagree."""

    pose: Floats
    covariance: Floats
    contradictions: int


def locate(
    rectangle: Rectangle, sensors_m: Floats, covered: Bools, yaw_hint_rad: float = 0.0
) -> Location | None:
    """Mean and spread of all poses that agree best with the sensors; None if none is covered.

    `sensors_m` has shape (S, 2), `covered` shape (S,). A rectangle looks the same after half a
    turn: the yaw is the one nearest to the hint.
    """
    if not covered.any():
        return None
    poses = _candidates(rectangle, sensors_m[covered], yaw_hint_rad)
    if not len(poses):
        return None
    wrong = _contradictions(rectangle, poses, sensors_m, covered)
    best = poses[wrong == wrong.min()]
    best = best[_likeliest_group(best[:, 2], yaw_hint_rad, rectangle.period_rad)]
    pose, covariance = _moments(best, rectangle.period_rad)
    pose[2] = rectangle.nearest_yaw_rad(float(pose[2]), yaw_hint_rad)
    return Location(pose, covariance, int(wrong.min()))


def _candidates(rectangle: Rectangle, covered_m: Floats, yaw_hint_rad: float) -> Floats:
    """Grid of poses (N, 3) whose corners' circle holds all covered sensors."""
    low_m = covered_m.max(axis=0) - rectangle.reach_m
    high_m = covered_m.min(axis=0) + rectangle.reach_m
    if (low_m > high_m).any():
        return np.empty((0, 3))
    x_m, y_m = (
        np.linspace(low, high, int((high - low) / _STEP_M) + 2)
        for low, high in zip(low_m, high_m, strict=True)
    )
    steps = round(rectangle.period_rad / _YAW_STEP_RAD)
    yaw_rad = yaw_hint_rad + rectangle.period_rad * (np.arange(steps) / steps - 0.5)
    return np.stack(np.meshgrid(x_m, y_m, yaw_rad, indexing="ij"), axis=-1).reshape(-1, 3)


def _contradictions(
    rectangle: Rectangle, poses: Floats, sensors_m: Floats, covered: Bools
) -> NDArray[np.int64]:
    """How many sensors each of the poses (N, 3) cannot explain, shape (N,)."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    wrong = np.zeros(len(poses), dtype=np.int64)
    for (x_m, y_m), is_covered in zip(sensors_m, covered, strict=True):
        dx_m, dy_m = x_m - poses[:, 0], y_m - poses[:, 1]
        inside = (np.abs(cos * dx_m + sin * dy_m) <= rectangle.length_m / 2) & (
            np.abs(cos * dy_m - sin * dx_m) <= rectangle.width_m / 2
        )
        wrong += inside != is_covered
    return wrong


def _likeliest_group(yaw_rad: Floats, yaw_hint_rad: float, period_rad: float) -> Bools:
    """Which poses belong to the likeliest run of neighbouring yaws (cyclic), near the hint."""
    values, index = np.unique(yaw_rad, return_inverse=True)
    likelihood = np.exp(-0.5 * ((yaw_rad - yaw_hint_rad) / _HINT_RAD) ** 2)
    gap = np.diff(values, append=values[0] + period_rad) > 1.5 * _YAW_STEP_RAD
    run = np.concatenate(([0], np.cumsum(gap[:-1])))
    if not gap[-1]:
        run[run == run[-1]] = run[0]
    likeliest = np.argmax(np.bincount(run[index], weights=likelihood))
    return np.asarray((run == likeliest)[index])


def _moments(poses: Floats, period_rad: float) -> tuple[Floats, Floats]:
    """Mean and covariance of poses whose yaws are cyclic; never finer than the search's grid."""
    turns = np.exp(2j * np.pi * poses[:, 2] / period_rad).mean()
    centre_rad = np.angle(turns) * period_rad / (2 * np.pi)
    unrolled = poses.copy()
    unrolled[:, 2] -= period_rad * np.round((poses[:, 2] - centre_rad) / period_rad)
    grid = np.diag([_STEP_M**2, _STEP_M**2, _YAW_STEP_RAD**2]) / 3
    spread = np.cov(unrolled.T, bias=True) if len(poses) > 1 else 0.0
    return unrolled.mean(axis=0), spread + grid
