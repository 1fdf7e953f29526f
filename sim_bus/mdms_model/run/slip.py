"""How fast wheels slip under parcels: their surface's speed over their parcel."""

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import Wheels, build_wheels
from mdms_model.arrays import Floats
from mdms_model.outline import outline_of
from mdms_model.run.record import Contact, Record
from mdms_model.scenario.scenario import Parcel, Scenario

#: So many samples are worked out at once, for the sake of memory.
_SAMPLES = 1000


def slip_m_s(scenario: Scenario, record: Record) -> Floats:
    """Speed of every wheel's surface over the parcel on it, along its direction [m/s].

    Positive ahead, 0 where there is no contact; shape (T, W).
    """
    wheels = build_wheels(scenario)
    parts = (
        slice(start, start + _SAMPLES) for start in range(0, max(len(record.time_s), 1), _SAMPLES)
    )
    return np.concatenate([_slip_m_s(scenario, wheels, record, part) for part in parts])


def _slip_m_s(scenario: Scenario, wheels: Wheels, record: Record, part: slice) -> Floats:
    """The same for some of the samples."""
    poses, twists = record.pose[part], record.twist[part]
    samples = np.arange(len(poses))[:, None]
    carried = _parcel_on(scenario, poses, wheels.position_m)
    pose, twist = poses[samples, carried], twists[samples, carried]
    arm_m = wheels.position_m - pose[..., :2]
    along_x, along_y = wheels.direction.T
    moved_m_s = along_x * (twist[..., 0] - twist[..., 2] * arm_m[..., 1])
    moved_m_s += along_y * (twist[..., 1] + twist[..., 2] * arm_m[..., 0])
    slip_m_s = record.speed_m_s[part] - moved_m_s
    return np.where(record.contact[part] != Contact.NONE, slip_m_s, 0.0)


def _parcel_on(scenario: Scenario, poses: Floats, place_m: Floats) -> NDArray[np.int64]:
    """The parcel whose outline lies nearest around each wheel, of those that are there; (T, W)."""
    outside_m = [
        _outside_m(parcel, poses[:, number, None], place_m)
        for number, parcel in enumerate(scenario.parcel)
    ]
    nearest: NDArray[np.int64] = np.argmin(np.nan_to_num(outside_m, nan=np.inf), axis=0)
    return nearest


def _outside_m(parcel: Parcel, pose: Floats, place_m: Floats) -> Floats:
    """How far places lie outside a parcel's outline at poses (T, 1, 3), negative within; (T, W)."""
    outline = outline_of(parcel)
    from_m = place_m - pose[..., :2]
    cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    along_m = cosine * from_m[..., 0] + sine * from_m[..., 1]
    across_m = cosine * from_m[..., 1] - sine * from_m[..., 0]
    outside_m: Floats = np.hypot(along_m, across_m) - outline.radius_m
    for normal_x, normal_y, distance_m in outline.edges[:, :3]:
        outside_m = np.maximum(outside_m, normal_x * along_m + normal_y * across_m - distance_m)
    return outside_m
