"""The state machine of a machine in a line: PackML, as in ISA-TR88.00.02 and OPC 30050.

It knows nothing of tables. States that act end by `Done`, when the table has done their work. There
is one table of transitions.
"""

from dataclasses import dataclass, field
from enum import IntEnum


class State(IntEnum):
    """The states, by their numbers in ISA-TR88.00.02."""

    CLEARING = 1
    STOPPED = 2
    STARTING = 3
    IDLE = 4
    SUSPENDED = 5
    EXECUTE = 6
    STOPPING = 7
    ABORTING = 8
    ABORTED = 9
    HOLDING = 10
    HELD = 11
    UNHOLDING = 12
    SUSPENDING = 13
    UNSUSPENDING = 14
    RESETTING = 15
    COMPLETING = 16
    COMPLETED = 17


class Command(IntEnum):
    """The commands, by their numbers in ISA-TR88.00.02."""

    RESET = 1
    START = 2
    STOP = 3
    HOLD = 4
    UNHOLD = 5
    SUSPEND = 6
    UNSUSPEND = 7
    ABORT = 8
    CLEAR = 9
    COMPLETE = 10


class Mode(IntEnum):
    """The modes. In maintenance other tools jog and commission the table, and Reset is refused."""

    PRODUCTION = 1
    MAINTENANCE = 2


class Done:
    """The end of an acting state, as a key of the table."""


DONE = Done()

_S, _C = State, Command
_STOPPABLE = (
    *(_S.STARTING, _S.IDLE, _S.SUSPENDED, _S.EXECUTE, _S.HOLDING, _S.HELD, _S.UNHOLDING),
    *(_S.SUSPENDING, _S.UNSUSPENDING, _S.RESETTING, _S.COMPLETING, _S.COMPLETED),
)

TRANSITIONS: dict[tuple[State, Command | Done], State] = {
    (_S.STOPPED, _C.RESET): _S.RESETTING,
    (_S.COMPLETED, _C.RESET): _S.RESETTING,
    (_S.RESETTING, DONE): _S.IDLE,
    (_S.IDLE, _C.START): _S.STARTING,
    (_S.STARTING, DONE): _S.EXECUTE,
    (_S.EXECUTE, _C.HOLD): _S.HOLDING,
    (_S.SUSPENDED, _C.HOLD): _S.HOLDING,
    (_S.HOLDING, DONE): _S.HELD,
    (_S.HELD, _C.UNHOLD): _S.UNHOLDING,
    (_S.UNHOLDING, DONE): _S.EXECUTE,
    (_S.EXECUTE, _C.SUSPEND): _S.SUSPENDING,
    (_S.SUSPENDING, DONE): _S.SUSPENDED,
    (_S.SUSPENDED, _C.UNSUSPEND): _S.UNSUSPENDING,
    (_S.UNSUSPENDING, DONE): _S.EXECUTE,
    (_S.EXECUTE, _C.COMPLETE): _S.COMPLETING,
    (_S.COMPLETING, DONE): _S.COMPLETED,
    **{(state, _C.STOP): _S.STOPPING for state in _STOPPABLE},
    (_S.STOPPING, DONE): _S.STOPPED,
    **{(each, _C.ABORT): _S.ABORTING for each in (*_STOPPABLE, _S.STOPPING, _S.STOPPED)},
    (_S.CLEARING, _C.ABORT): _S.ABORTING,
    (_S.ABORTING, DONE): _S.ABORTED,
    (_S.ABORTED, _C.CLEAR): _S.CLEARING,
    (_S.CLEARING, DONE): _S.STOPPED,
}
#: Parcels may move in these states, and in no others.
MOVING = (_S.EXECUTE, _S.COMPLETING)
#: Commands after which parcels may move.
MOVES = (_C.START, _C.UNHOLD, _C.UNSUSPEND)
#: Commands by which parcels stand; they are never too late.
STANDS = (_C.STOP, _C.ABORT, _C.HOLD, _C.SUSPEND)


class CommandRefusedError(Exception):
    """A command that does not fit the state: one line with the commands that do."""


@dataclass(slots=True)
class StateMachine:
    """The present state, since when [s], its reason, and the time spent in each state [s]."""

    state: State = State.STOPPED
    mode: Mode = Mode.PRODUCTION
    since_s: float = 0.0
    reason: str = ""
    spent_s: dict[State, float] = field(default_factory=dict)
    changes: int = 0

    @property
    def commands(self) -> tuple[Command, ...]:
        """The commands that the state takes in this mode."""
        left_out = Command.RESET if self.mode is Mode.MAINTENANCE else None
        taken = (each for each in Command if (self.state, each) in TRANSITIONS)
        return tuple(each for each in taken if each is not left_out)

    def after(self, cause: Command | Done) -> State:
        """The next state. Raises `CommandRefusedError`."""
        after = TRANSITIONS.get((self.state, cause))
        if after is None:
            name = cause.name.capitalize() if isinstance(cause, Command) else "The end"
            fitting = ", ".join(each.name.capitalize() for each in self.commands) or "none"
            raise CommandRefusedError(
                f"{name} is not possible in {self.state.name.capitalize()}; possible: {fitting}"
            )
        if cause is Command.RESET and self.mode is Mode.MAINTENANCE:
            raise CommandRefusedError("Reset is not possible in maintenance; change the mode first")
        return after

    def on(self, cause: Command | Done, now_s: float, reason: str = "") -> None:
        """Go on to the next state. Raises `CommandRefusedError`."""
        after = self.after(cause)
        self.spent_s[self.state] = self.in_state_s(self.state, now_s)
        self.state, self.since_s, self.changes = after, now_s, self.changes + 1
        if reason or isinstance(cause, Command):
            self.reason = reason

    def change_mode(self, mode: Mode) -> None:
        """Work in this mode; another is refused by `CommandRefusedError` but in Stopped."""
        if mode is not self.mode and self.state is not State.STOPPED:
            raise CommandRefusedError(
                f"the mode is not changed in {self.state.name.capitalize()}, but in Stopped alone"
            )
        self.mode = mode

    def in_state_s(self, state: State, now_s: float) -> float:
        """How long it has been in a state, all in all [s]."""
        now_in_s = now_s - self.since_s if state is self.state else 0.0
        return self.spent_s.get(state, 0.0) + now_in_s
