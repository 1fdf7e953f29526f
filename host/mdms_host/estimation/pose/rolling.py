"""Parcels roll on with the wheels under them: the twists of all, from the speeds of all wheels."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mdms_host.estimation.pose.estimator import ParcelEstimator
from mdms_host.estimation.pose.twist_fit import fit_twists
from mdms_host.estimation.presence.surroundings import Near
from mdms_model.arrays import Bools, Floats


@dataclass(frozen=True, slots=True)
class Speeds:
    """The speeds of all wheels at one time, all of shape (W,).

    Wheels that are not `known` are left out (None: all are); without any under a parcel its twist
    stays for a while. Where all of them are `standing` so is the parcel, whatever their speeds.
    """

    speed_m_s: Floats
    known: Bools | None = None
    standing: Bools | None = None


def roll_on(estimators: Iterable[ParcelEstimator], now_s: float, speeds: Speeds) -> None:
    """Take all parcels that have a pose on to the time at which the wheels had these speeds."""
    moving: list[tuple[ParcelEstimator, Floats, Near, Bools]] = []
    for one in estimators:
        pose = one.pose
        if pose is None:
            continue
        near = one.near(pose)
        under = one.bottom.distance_m(near.wheels_m, pose) < 0
        count = under.sum()
        if speeds.known is not None:
            under &= speeds.known[near.wheels]
        if count and not under.any():
            one.roll(now_s, None)
        elif not count or _all_stand(speeds, near, under):
            one.roll(now_s, np.zeros(3))
        else:
            moving.append((one, pose, near, under))
    if not moving:
        return
    # Columns in metres per second alike, so that a motion that no wheel shows comes out as zero.
    twists = fit_twists(
        [near.surface_jacobian(pose)[under] * one.corner_m for one, pose, near, under in moving],
        [speeds.speed_m_s[near.wheels[under]] for _, _, near, under in moving],
        np.array([one.twist / one.corner_m for one, _, _, _ in moving]),
    )
    for (one, _, _, _), twist in zip(moving, twists, strict=True):
        one.roll(now_s, twist * one.corner_m)


def _all_stand(speeds: Speeds, near: Near, under: Bools) -> bool:
    return speeds.standing is not None and bool(speeds.standing[near.wheels[under]].all())
