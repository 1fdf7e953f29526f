"""The plans of a program as they take effect, for the record of its run."""

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.programs.program import TableProgram
from mdms_model.run.record import Plan, Tile

#: A run of any length is kept with the last of so many plans.
MOST_PLANS = 5000


class PlanLog:
    """Keeps each plan of a program, if it makes any; look as often as plans may change."""

    def __init__(self, coordinator: Coordinator) -> None:
        self.plans: list[Plan] = []
        self._coordinator = coordinator
        self._last: object = None

    def look(self, time_s: float) -> None:
        """Keep the plan that is in effect, if it is another."""
        program = self._coordinator.program
        if not isinstance(program, TableProgram) or program.plan is self._last:
            return
        self._last = program.plan
        tiles = tuple(Tile(*tile) for tile in program.reserved)
        self.plans.append(Plan(time_s, dict(program.ways), tiles))
        del self.plans[:-MOST_PLANS]
