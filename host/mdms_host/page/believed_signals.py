"""What a coordinator believes and wants of the parcels, as signals."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.page.shown.description import PARCEL_STATES, PHASES

_FOUND, _DOUBTFUL, _ARRIVED, _UNKNOWN = (
    PARCEL_STATES.index(state) for state in ("found", "doubtful", "arrived", "unknown")
)


def believed_signals(names: Iterable[str], coordinator: Coordinator) -> dict[str, Any]:
    """Pose, spread, goal and state of what has these names, in their order, and the phase."""
    names, goals = list(names), coordinator.goals
    believed, goal = np.full((2, len(names), 3), np.nan)
    spread, state = np.full((len(names), 4), np.nan), np.zeros(len(names), np.uint8)
    for number, name in enumerate(names):
        if name in goals:
            wanted = goals[name]
            yaw_rad = np.nan if wanted.yaw_rad is None else wanted.yaw_rad
            goal[number] = wanted.x_m, wanted.y_m, yaw_rad
        unknown = coordinator.tracker.unknown.get(name)
        if unknown is not None:
            believed[number], state[number] = unknown.pose, _UNKNOWN
        elif (estimate := coordinator.estimate(name)) is not None:
            believed[number] = estimate.x_m, estimate.y_m, estimate.yaw_rad
            covariance = coordinator.tracker.covariance(name)
            spread[number] = covariance[[0, 0, 1, 2], [0, 1, 1, 2]]
            state[number] = _state_of(name, coordinator)
    return {
        "phase": [PHASES.index(coordinator.phase.value)],
        "parcel_believed": believed,
        "parcel_spread": spread,
        "parcel_goal": goal,
        "parcel_state": state,
    }


def _state_of(name: str, coordinator: Coordinator) -> int:
    """The number of the state of a parcel that is believed somewhere."""
    if name in coordinator.tracker.doubtful:
        return _DOUBTFUL
    return _ARRIVED if name in coordinator.arrived_s else _FOUND
