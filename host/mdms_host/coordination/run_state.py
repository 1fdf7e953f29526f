"""The state that all parts of a run share: its phase, its schedule and its journal.

The phases and their transitions are one table.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import inf


class Phase(StrEnum):
    """Phase of the coordinator; a cell that is brought back has its own phase."""

    WAITING = "waiting for the cells"
    IDENTIFYING = "identifying the cells"
    CONFIGURING = "writing settings"
    STARTING = "starting the cells"
    ENABLING = "enabling the drives"
    RUNNING = "running"
    HOLDING = "holding all parcels"
    RECOVERING = "bringing cells back"
    KEEPING = "keeping all parcels where they are"
    STOPPING = "stopping"
    FAILING = "stopping after a fault"
    STOPPED = "stopped"
    FAILED = "stopped after a fault"


class RunSignal(StrEnum):
    """Cause for the end of a phase."""

    DONE = "done"
    #: Cells are out of action, but may come back.
    TROUBLE = "trouble"
    #: They have not come back in time, and the run goes on, or ends, without them.
    WITHOUT = "without"
    #: Somebody wants all parcels to stand for as long as they say.
    KEEP = "keep"
    STOP = "stop"
    FAULT = "fault"


BRING_UP = (
    *(Phase.WAITING, Phase.IDENTIFYING, Phase.CONFIGURING),
    *(Phase.STARTING, Phase.ENABLING),
)
#: Parcels are held until cells are back.
TROUBLED = (Phase.HOLDING, Phase.RECOVERING)
#: All references are 0, or on their way there.
HELD = (*TROUBLED, Phase.KEEPING)
#: The cells are up, and cared for.
UP = (Phase.RUNNING, *HELD)
STOPPED = (Phase.STOPPED, Phase.FAILED)

TRANSITIONS: dict[tuple[Phase, RunSignal], Phase] = {
    (Phase.WAITING, RunSignal.DONE): Phase.IDENTIFYING,
    (Phase.IDENTIFYING, RunSignal.DONE): Phase.CONFIGURING,
    (Phase.CONFIGURING, RunSignal.DONE): Phase.STARTING,
    (Phase.STARTING, RunSignal.DONE): Phase.ENABLING,
    (Phase.ENABLING, RunSignal.DONE): Phase.RUNNING,
    (Phase.RUNNING, RunSignal.TROUBLE): Phase.HOLDING,
    (Phase.HOLDING, RunSignal.DONE): Phase.RECOVERING,
    (Phase.RECOVERING, RunSignal.TROUBLE): Phase.HOLDING,
    (Phase.RECOVERING, RunSignal.DONE): Phase.RUNNING,
    **{(phase, RunSignal.WITHOUT): Phase.RUNNING for phase in TROUBLED},
    (Phase.RUNNING, RunSignal.KEEP): Phase.KEEPING,
    (Phase.KEEPING, RunSignal.TROUBLE): Phase.HOLDING,
    (Phase.KEEPING, RunSignal.DONE): Phase.RUNNING,
    (Phase.STOPPING, RunSignal.DONE): Phase.STOPPED,
    (Phase.STOPPING, RunSignal.WITHOUT): Phase.FAILED,
    (Phase.FAILING, RunSignal.DONE): Phase.FAILED,
    (Phase.FAILING, RunSignal.WITHOUT): Phase.FAILED,
    **{(phase, RunSignal.STOP): Phase.STOPPING for phase in (*BRING_UP, *UP)},
    **{(phase, RunSignal.FAULT): Phase.FAILING for phase in (*BRING_UP, *UP, Phase.STOPPING)},
}


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
        late_s = now_s - self._due_s.get(name, inf) + _EPSILON_S
        if late_s < 0:
            return False
        self.set(name, self._due_s[name] + period_s * (1 + late_s // period_s))
        return True


#: A journal has at least so many of the latest events, and twice as many at most.
EVENTS_KEPT = 20_000


class EventJournal:
    """The latest `events`, and the `troubles` that need a person, as (time [s], text)."""

    def __init__(self) -> None:
        self.events: list[tuple[float, str]] = []
        self.troubles: list[tuple[float, str]] = []
        self._dropped = 0

    def since(self, number: int) -> tuple[list[tuple[float, str]], int]:
        """The events that came after so many, as far as they are kept; and how many came in all."""
        return self.events[max(0, number - self._dropped) :], self._dropped + len(self.events)

    def note(self, time_s: float, text: str) -> None:
        """Something has happened."""
        self.events.append((time_s, text))
        if len(self.events) == 2 * EVENTS_KEPT:
            del self.events[:EVENTS_KEPT]
            self._dropped += EVENTS_KEPT

    def warn(self, time_s: float, text: str) -> None:
        """Something has happened that a person should look after, though the run goes on."""
        self.troubles.append((time_s, text))
        del self.troubles[:-EVENTS_KEPT]
        self.note(time_s, text)
