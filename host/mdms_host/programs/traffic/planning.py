"""Plans off the cycle: asked for in one, they take effect some cycles later, as far as they go."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

from mdms_host.routes.planner import RoutePlan

#: A plan takes effect so many cycles after it was asked for, or when it is ready if that is later.
DELAY_CYCLES = 3


class PlanExecutor(Protocol):
    """Where plans are made, one at a time; `real_time` is whether time passes meanwhile."""

    @property
    def real_time(self) -> bool:
        """Whether the cycle goes on while a plan is made."""
        ...

    @property
    def is_busy(self) -> bool:
        """Whether a plan has been asked for that has not been taken yet."""
        ...

    def ask(self, work: Callable[[], RoutePlan]) -> None:
        """Have a plan made."""
        ...

    def take(self) -> RoutePlan | None:
        """The plan that was asked for, once it is ready; called once a cycle."""
        ...


class VirtualExecutor:
    """Makes plans at once and holds them back: virtual time does not pass by computing."""

    real_time = False

    def __init__(self) -> None:
        self._plan: RoutePlan | None = None
        self._cycles = 0

    @property
    def is_busy(self) -> bool:
        """See `PlanExecutor`."""
        return self._plan is not None

    def ask(self, work: Callable[[], RoutePlan]) -> None:
        """See `PlanExecutor`."""
        self._plan, self._cycles = work(), 0

    def take(self) -> RoutePlan | None:
        """See `PlanExecutor`."""
        if self._plan is None:
            return None
        self._cycles += 1
        if self._cycles < DELAY_CYCLES:
            return None
        plan, self._plan = self._plan, None
        return plan


class ThreadExecutor:
    """Makes plans in a thread of its own, beside the cycle in real time."""

    real_time = True

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, "planning")
        self._future: Future[RoutePlan] | None = None
        self._cycles = 0

    @property
    def is_busy(self) -> bool:
        """See `PlanExecutor`."""
        return self._future is not None

    def ask(self, work: Callable[[], RoutePlan]) -> None:
        """See `PlanExecutor`."""
        self._future, self._cycles = self._executor.submit(work), 0

    def take(self) -> RoutePlan | None:
        """See `PlanExecutor`; raises the planner's error."""
        if self._future is None:
            return None
        self._cycles += 1
        if self._cycles < DELAY_CYCLES or not self._future.done():
            return None
        plan, self._future = self._future.result(), None
        return plan
