"""What hosts that come and go believe, plan and report, for the record of a table that stays."""

from collections.abc import Callable

import numpy as np

from mdms_host.cli.records.plan_log import MOST_PLANS, PlanLog
from mdms_host.cli.scenario.coordination import estimates_of
from mdms_host.coordination.coordinator import Coordinator
from mdms_model.arrays import Floats
from mdms_model.run.record import Event, Plan, Record
from mdms_model.scenario.scenario import Scenario


class HostLog:
    """Keeps what every coordinator in its turn has planned and reported.

    `present` returns the one that is there, None without one.
    """

    def __init__(self, scenario: Scenario, present: Callable[[], Coordinator | None]) -> None:
        self._scenario = scenario
        self._present = present
        self._unknown: Floats = np.full((len(scenario.parcel), 3), np.nan)
        self._last: tuple[Coordinator, PlanLog] | None = None
        self._plans: list[Plan] = []
        self._events: list[Event] = []

    def sample(self, time_s: float) -> Floats:
        """The poses that are believed now [m, m, rad], shape (P, 3), NaN where unknown."""
        coordinator = self._present()
        if coordinator is None:
            return self._unknown
        if self._last is None or self._last[0] is not coordinator:
            self._close()
            self._last = coordinator, PlanLog(coordinator)
        self._last[1].look(time_s)
        return estimates_of(coordinator, self._scenario)

    def add_to(self, record: Record) -> None:
        """Put plans and events into the record of the same table."""
        self._close()
        record.plans = self._plans
        record.events = sorted(record.events + self._events, key=lambda event: event.time_s)

    def _close(self) -> None:
        """The coordinator that was there reports nothing more."""
        if self._last is not None:
            coordinator, log = self._last
            self._plans = (self._plans + log.plans)[-MOST_PLANS:]
            self._events += coordinator_events(coordinator)
            self._last = None


def coordinator_events(coordinator: Coordinator) -> list[Event]:
    """What a coordinator has reported."""
    return [Event(time_s, "coordinator", text) for time_s, text in coordinator.events]
