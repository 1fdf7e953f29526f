"""Due times of the coordinator's repeated frames."""

from dataclasses import dataclass
from math import inf

#: Due times may be missed by rounding alone.
_EPSILON_S = 1e-9


@dataclass(frozen=True, slots=True)
class Timing:
    """Periods and time limits of the coordinator [s].

    Setpoints go out half a period after SYNC, when the speeds of that SYNC have come in, and are
    taken over at the next one.
    """

    sync_period_s: float = 0.01
    heartbeat_period_s: float = 0.1
    status_period_s: float = 0.2
    silence_periods: float = 3.0
    speeds_limit_s: float = 0.1
    command_period_s: float = 0.05
    phase_limit_s: float = 5.0
    stop_limit_s: float = 0.5

    @property
    def silence_s(self) -> float:
        """How long a cell may go without a heartbeat [s]."""
        return self.silence_periods * self.heartbeat_period_s + _EPSILON_S


class Schedule:
    """Times at which named things are due next [s]; a name that was never set is never due.

    `wake_s` is the next time at which anything is due; infinity when nothing is.
    """

    def __init__(self) -> None:
        self._due_s: dict[str, float] = {}
        self.wake_s = inf

    def next_s(self, name: str) -> float:
        """When the thing is due next [s]."""
        return self._due_s.get(name, inf)

    def set(self, name: str, due_s: float) -> None:
        """Make the thing due at that time."""
        self._due_s[name] = due_s
        # Read far more often than set: a driver reads it after every frame.
        self.wake_s = min(self._due_s.values())

    def cancel(self, name: str) -> None:
        """Make the thing not due at all."""
        self.set(name, inf)

    def take(self, name: str, now_s: float, period_s: float) -> bool:
        """Whether the thing is due; if so it is due again a period on, times missed left out."""
        late_s = now_s - self.next_s(name) + _EPSILON_S
        if late_s < 0:
            return False
        self.set(name, self._due_s[name] + period_s * (1 + late_s // period_s))
        return True
