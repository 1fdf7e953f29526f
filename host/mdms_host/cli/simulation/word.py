"""What a coordinator says of its run, as the referee of a simulation takes it."""

from collections.abc import Mapping
from math import inf

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.motion.goal import Goal
from mdms_sim.referee.truth import HostReport, Pose


def host_report_of(coordinator: Coordinator | None) -> HostReport | None:
    """What it says now; None where none runs."""
    if coordinator is None:
        return None
    troubles = coordinator.troubles
    stopped = "stopped by a person" if coordinator.stopped else None
    return HostReport(
        goals=_poses(coordinator.goals),
        arrived=_poses(coordinator.arrived),
        reason=coordinator.fault or coordinator.stuck or coordinator.lost or stopped,
        trouble_s=troubles[-1][0] if troubles else -inf,
        over=coordinator.finished,
    )


def _poses(goals: Mapping[str, Goal]) -> dict[str, Pose]:
    return {name: (goal.x_m, goal.y_m, goal.yaw_rad) for name, goal in goals.items()}
