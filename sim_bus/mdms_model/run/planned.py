"""The plan at a time of a run."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from operator import attrgetter

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.run.record import Plan, Record
from mdms_model.scenario.scenario import Scenario, goal_of


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
