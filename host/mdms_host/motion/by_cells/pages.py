"""The pages of a motion program, as cells get them: the parcel, its place and its goal."""

from math import pi

from mdms_host.estimation.tracker import Parcel
from mdms_host.motion.goal import Goal, Limits
from mdms_model.arrays import Floats
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages

_STEP_M = wire.STEP_UM * 1e-6
_SHAPES = {"rectangle": wire.RECTANGLE, "disc": wire.DISC}


def parcel_page(
    identity: int, sequence: int, parcel: Parcel, limits: Limits, flags: int
) -> messages.Parcel:
    """Outline and limits of a parcel; limits below a step of the wire are one step.

    Raises KeyError for a shape that no page has.
    """
    return messages.Parcel(
        identity,
        sequence,
        _SHAPES[parcel.shape],
        round(parcel.length_m / _STEP_M),
        round((parcel.length_m if parcel.shape == "disc" else parcel.width_m) / _STEP_M),
        max(round(limits.acceleration_m_s2 * 1e3 / wire.ACCELERATION_MM_S2), 1),
        max(round(limits.speed_m_s * 1e3 / wire.SPEED_MM_S), 1),
        flags,
    )


def flags_of(goal: Goal | None, *, go_on: bool, planned: bool) -> int:
    """The flags of a parcel on its way to a goal."""
    any_yaw = goal is not None and goal.yaw_rad is None
    flags = (wire.GO_ON if go_on else 0) | (wire.ANY_YAW if any_yaw else 0)
    return flags | (0 if planned else wire.UNPLANNED)


def place_page(identity: int, sequence: int, pose: Floats) -> messages.Place:
    """Where a parcel is."""
    x_m, y_m, yaw_rad = pose.tolist()
    return messages.Place(identity, sequence, *_steps(x_m, y_m, yaw_rad))


def goal_page(
    identity: int, sequence: int, goal: Goal, leg: int = 0, legs: int = 0
) -> messages.Goal:
    """Where a parcel is to go, or where a leg of its way ends; `leg` and `legs` as in `frames`."""
    steps = _steps(goal.x_m, goal.y_m, goal.yaw_rad or 0.0)
    return messages.Goal(identity, sequence, *steps, leg, legs)


def _steps(x_m: float, y_m: float, yaw_rad: float) -> tuple[int, int, int]:
    half = wire.TURN // 2
    turn = (round(yaw_rad / (2 * pi) * wire.TURN) + half) % wire.TURN - half
    return round(x_m / _STEP_M), round(y_m / _STEP_M), turn
