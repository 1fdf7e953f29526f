"""Parcels roll on with the wheels under them: the twists of all, from the speeds of all wheels.

The twist is the one that most wheels under a parcel agree on: wheels that slip count little.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mdms_host.estimation.pose.estimator import ParcelEstimator
from mdms_model.arrays import Bools, Floats

#: Wheels this far from the fit are taken to slip.
_SLIPPING_M_S = 0.003
_ROUNDS = 5
#: Keeps a fit solvable, and at zero, where no wheel shows a motion (a row: neither y nor yaw).
_RIDGE = 1e-10
#: The nine sums of a round are of products of two of the columns (u, v, w, speed).
_LEFT = np.array([0, 0, 0, 1, 1, 2, 3, 3, 3])
_RIGHT = np.array([0, 1, 2, 1, 2, 2, 0, 1, 2])


def fit_twists(jacobians: Sequence[Floats], speeds_m_s: Sequence[Floats], starts: Floats) -> Floats:
    """Twists that explain the speeds of the wheels of each of P parcels, shape (P, 3).

    Least squares, reweighted in rounds: an error e counts as 1 / (1 + (e / s)^2), s being one and a
    half of their median. A jacobian, of shape (W, 3), maps a twist to speeds, of shape (W,), of at
    least one wheel; its columns should be of one unit. `starts` are of shape (P, 3).
    """
    counts = np.array([len(speeds) for speeds in speeds_m_s])
    columns = np.zeros((len(counts), 4, counts.max()))
    for number, (jacobian, speeds) in enumerate(zip(jacobians, speeds_m_s, strict=True)):
        columns[number, :3, : len(speeds)] = jacobian.T
        columns[number, 3, : len(speeds)] = speeds
    u, v, w, speed_m_s = columns.transpose(1, 0, 2)
    is_wheel = (np.arange(counts.max()) < counts[:, None]).astype(np.float64)
    nothing = np.where(is_wheel, 0.0, np.inf)
    products = columns[:, _LEFT] * columns[:, _RIGHT]
    # The middle one, or the upper of the two.
    middle = np.arange(len(counts)), counts // 2
    twists = starts
    for _ in range(_ROUNDS):
        x, y, z = twists.T[:, :, None]
        squares = (speed_m_s - u * x - v * y - w * z) ** 2
        ranked = squares + nothing
        ranked.sort(axis=1)
        limit_m2_s2 = np.maximum(_SLIPPING_M_S**2, 2.25 * ranked[middle])
        weight = is_wheel / (limit_m2_s2[:, None] + squares)
        # Summed one after the other, so that the result is the same on every machine.
        sums = (weight[:, None] * products).cumsum(axis=2)[:, :, -1]
        twists = np.array([_solve(each) for each in sums.tolist()])
    return twists


def _solve(sums: Sequence[float]) -> tuple[float, float, float]:
    """The solution of [[a b c] [b d e] [c e f]] (x y z) = (p q r), by L D L^T, with a ridge."""
    a, b, c, d, e, f, p, q, r = sums
    ridge = _RIDGE * (a + d + f)
    a, d, f = a + ridge, d + ridge, f + ridge
    low_b, low_c = b / a, c / a
    d, e, f, q, r = d - low_b * b, e - low_b * c, f - low_c * c, q - low_b * p, r - low_c * p
    low_e = e / d
    z = (r - low_e * q) / (f - low_e * e)
    y = (q - e * z) / d
    return (p - b * y - c * z) / a, y, z


@dataclass(frozen=True, slots=True)
class Speeds:
    """The speeds of all wheels at one time, all of shape (W,).

    Wheels that are not `known` are left out (None: all are). A motion that none of the others
    shows stays for a while. Where all of them are `standing` so is the parcel, whatever their
    speeds.
    """

    speed_m_s: Floats
    known: Bools | None = None
    standing: Bools | None = None


def roll_on(estimators: Iterable[ParcelEstimator], now_s: float, speeds: Speeds) -> None:
    """Take all parcels that have a pose on to the time at which the wheels had these speeds."""
    moving: list[tuple[ParcelEstimator, Floats, Floats, Floats]] = []
    for one in estimators:
        pose = one.pose
        if pose is None:
            continue
        around = one.wheels_under(pose)
        near, under, shown = around.near, around.under, around.count
        if speeds.known is not None:
            under = under & speeds.known[near.wheels]
            shown = int(under.sum())
        wheels = near.wheels[under]
        if around.count and not shown:
            one.roll(now_s, None)
        elif not shown or (speeds.standing is not None and speeds.standing[wheels].all()):
            one.roll(now_s, np.zeros(3))
        else:
            # Columns in metres per second alike.
            jacobian = near.surface_jacobian(pose)[under] * one.corner_m
            missing = shown < around.count
            kept = one.kept_twist(now_s, missing=missing) / one.corner_m
            moving.append((one, jacobian, speeds.speed_m_s[wheels], kept))
    if not moving:
        return
    # A motion that no wheel shows comes out as zero, on top of what is kept.
    twists = fit_twists(
        [jacobian for _, jacobian, _, _ in moving],
        [speed_m_s - jacobian @ kept for _, jacobian, speed_m_s, kept in moving],
        np.array([one.twist / one.corner_m - kept for one, _, _, kept in moving]),
    )
    for (one, _, _, kept), twist in zip(moving, twists, strict=True):
        one.roll(now_s, (kept + twist) * one.corner_m)
