"""Quantities derived from a record: plans in effect, slip of wheels, errors of beliefs."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import Wheels, build_wheels
from mdms_model.arrays import Floats
from mdms_model.outline import outline_of
from mdms_model.run.record import Contact, Plan, Record
from mdms_model.scenario.scenario import Parcel, Scenario, goal_of
from mdms_protocol.neighbours import frames as wire


def plan_at(record: Record, time_s: float) -> Plan | None:
    """The plan that took effect last; None before the first."""
    count = bisect_right(record.plans, time_s, key=attrgetter("time_s"))
    return record.plans[count - 1] if count else None


def goals_at(scenario: Scenario, record: Record, time_s: float) -> Mapping[str, Floats]:
    """Goals by parcel, poses (3,), the yaw NaN where any will do.

    Where nothing was planned they are those of the scenario.
    """
    if record.plans:
        plan = plan_at(record, time_s)
        return {} if plan is None else plan.goals
    goals = {parcel.name: goal_of(scenario, parcel) for parcel in scenario.parcel}
    return {
        name: np.array([goal.x_m, goal.y_m, goal.yaw_rad])
        for name, goal in goals.items()
        if goal is not None
    }


def goals_given(record: Record) -> Iterator[tuple[float, str, Floats]]:
    """Each goal that a parcel is given: when [s], to which, and the pose as of `goals_at`."""
    before: Mapping[str, Floats] = {}
    for plan in record.plans:
        for name, goal in plan.goals.items():
            if not np.array_equal(goal, before.get(name, ()), equal_nan=True):
                yield plan.time_s, name, goal
        before = plan.goals


#: So many samples are worked out at once, for the sake of memory.
_SAMPLES = 1000


def lifted_s(record: Record, parcel: str) -> float | None:
    """Since when a parcel is off the table at the end of a record [s]; None where it is on it."""
    hands, since_s = 0, 0.0
    for event in record.events:
        if event.kind != "fault" or event.parcel != parcel:
            continue
        if event.detail.startswith("lift begins"):
            since_s = since_s if hands else event.time_s
            hands += 1
        elif event.detail.startswith("lift ends"):
            hands -= 1
    return since_s if hands else None


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
    if not scenario.parcel:
        return np.zeros_like(record.speed_m_s[part])
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


def shared_belief(record: Record, number: int) -> Floats:
    """The mean pose that cells under parcel `number` (from 0) report, shape (T, 3).

    NaN where no cell under it reports one, and in a run without a neighbour layer.
    """
    if record.identity is None or record.state is None or record.belief is None:
        return np.full((len(record.time_s), 3), np.nan)
    under = (record.identity == number + 1) & (record.state == wire.UNDER)
    told = under & np.isfinite(record.belief).all(axis=2)
    count = np.count_nonzero(told, axis=1)
    x_m, y_m, yaw_rad = np.moveaxis(np.where(told[..., None], record.belief, 0.0), 2, 0)
    # Yaws are told within a turn: their mean is that of their directions.
    ahead, aside = (np.where(told, part(yaw_rad), 0.0).sum(axis=1) for part in (np.cos, np.sin))
    with np.errstate(invalid="ignore"):
        place_m = [part.sum(axis=1) / count for part in (x_m, y_m)]
    turned = np.where(count > 0, np.arctan2(aside, ahead), np.nan)
    return np.stack((*place_m, turned), axis=1)


def belief_error(record: Record, number: int, parcel: Parcel) -> Floats:
    """How far the shared belief is off: distance [m] and size of the turn [rad], shape (T, 2).

    A disc's turn cannot be seen: NaN.
    """
    return _error(shared_belief(record, number) - record.pose[:, number], parcel)


def host_error(scenario: Scenario, record: Record, number: int) -> Floats:
    """The same of the coordinator's belief; NaN without one.

    Parcels of one kind are alike: a belief is of that to which it is nearest, whatever its name.
    """
    parcel, samples = scenario.parcel[number], len(record.time_s)
    if record.estimate is None:
        return np.full((samples, 2), np.nan)
    alike = [
        other
        for other, each in enumerate(scenario.parcel)
        if other == number or (each.kind and each.kind == parcel.kind)
    ]
    believed, true = record.estimate[:, alike], record.pose[:, alike]
    apart_m = np.hypot(*np.moveaxis(believed[:, :, None, :2] - true[:, None, :, :2], 3, 0))
    apart_m = np.nan_to_num(apart_m, nan=np.inf)
    mine = alike.index(number)
    of_mine = np.argmin(apart_m, axis=2) == mine
    nearest = np.argmin(np.where(of_mine, apart_m[:, :, mine], np.inf), axis=1)
    every = np.arange(samples)
    away = believed[every, nearest] - record.pose[:, number]
    away[~of_mine[every, nearest]] = np.nan
    return _error(away, parcel)


def _error(away: Floats, parcel: Parcel) -> Floats:
    turn_rad = abs((away[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    if parcel.shape == "disc":
        turn_rad[:] = np.nan
    return np.stack((np.hypot(away[:, 0], away[:, 1]), turn_rad), axis=1)


def cell_counts(record: Record) -> dict[int, Floats]:
    """How many cells are under parcels, promised and near, by the state's code, each (T,)."""
    if record.state is None:
        return {}
    return {
        state: np.count_nonzero(record.state == state, axis=1).astype(float)
        for state in (wire.UNDER, wire.PROMISED, wire.NEAR)
    }
