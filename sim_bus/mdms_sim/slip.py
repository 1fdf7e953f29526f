"""How fast wheels slip under parcels: their surface's speed over what they carry."""

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.wheels import build_wheels
from mdms_sim.record import Contact, Floats, Record
from mdms_sim.scenario import Scenario


def slip_m_s(scenario: Scenario, record: Record) -> Floats:
    """Speed of every wheel's surface over the parcel on it, along its direction [m/s].

    Positive ahead, 0 where there is no contact; shape (T, W).
    """
    wheels = build_wheels(scenario)
    samples = np.arange(len(record.time_s))[:, None]
    carried = _parcel_on(scenario, record, wheels.position_m)
    pose, twist = record.pose[samples, carried], record.twist[samples, carried]
    arm_m = wheels.position_m - pose[..., :2]
    along_x, along_y = wheels.direction.T
    moved_m_s = along_x * (twist[..., 0] - twist[..., 2] * arm_m[..., 1])
    moved_m_s += along_y * (twist[..., 1] + twist[..., 2] * arm_m[..., 0])
    return np.where(record.contact != Contact.NONE, record.speed_m_s - moved_m_s, 0.0)


def _parcel_on(scenario: Scenario, record: Record, place_m: Floats) -> NDArray[np.int64]:
    """The parcel deepest over each wheel, in shares of its half length and width; (T, W)."""
    from_m = place_m - record.pose[:, :, None, :2]
    cosine, sine = np.cos(record.pose[..., 2:]), np.sin(record.pose[..., 2:])
    along_m = cosine * from_m[..., 0] + sine * from_m[..., 1]
    across_m = cosine * from_m[..., 1] - sine * from_m[..., 0]
    length_m = np.array([parcel.length_m for parcel in scenario.parcel])[:, None]
    width_m = np.array([parcel.width_m for parcel in scenario.parcel])[:, None]
    depth: NDArray[np.float64] = np.maximum(abs(along_m) / length_m, abs(across_m) / width_m)
    deepest: NDArray[np.int64] = depth.argmin(axis=1)
    return deepest
