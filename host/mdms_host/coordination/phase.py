"""The coordinator's life as one table of transitions."""

from enum import StrEnum


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
    STOPPING = "stopping"
    FAILING = "stopping after a fault"
    STOPPED = "stopped"
    FAILED = "stopped after a fault"


class Signal(StrEnum):
    """Cause for the end of a phase."""

    DONE = "done"
    #: Cells are out of action, but may come back.
    TROUBLE = "trouble"
    #: They have not come back in time, and the run goes on without them.
    WITHOUT = "without"
    STOP = "stop"
    FAULT = "fault"


BRING_UP = (
    *(Phase.WAITING, Phase.IDENTIFYING, Phase.CONFIGURING),
    *(Phase.STARTING, Phase.ENABLING),
)
#: All references are 0, or on their way there.
HELD = (Phase.HOLDING, Phase.RECOVERING)
#: The cells are up, and cared for.
UP = (Phase.RUNNING, *HELD)
STOPPED = (Phase.STOPPED, Phase.FAILED)

TRANSITIONS: dict[tuple[Phase, Signal], Phase] = {
    (Phase.WAITING, Signal.DONE): Phase.IDENTIFYING,
    (Phase.IDENTIFYING, Signal.DONE): Phase.CONFIGURING,
    (Phase.CONFIGURING, Signal.DONE): Phase.STARTING,
    (Phase.STARTING, Signal.DONE): Phase.ENABLING,
    (Phase.ENABLING, Signal.DONE): Phase.RUNNING,
    (Phase.RUNNING, Signal.TROUBLE): Phase.HOLDING,
    (Phase.HOLDING, Signal.DONE): Phase.RECOVERING,
    (Phase.RECOVERING, Signal.TROUBLE): Phase.HOLDING,
    (Phase.RECOVERING, Signal.DONE): Phase.RUNNING,
    **{(phase, Signal.WITHOUT): Phase.RUNNING for phase in HELD},
    (Phase.STOPPING, Signal.DONE): Phase.STOPPED,
    (Phase.FAILING, Signal.DONE): Phase.FAILED,
    **{(phase, Signal.STOP): Phase.STOPPING for phase in (*BRING_UP, *UP)},
    **{(phase, Signal.FAULT): Phase.FAILING for phase in (*BRING_UP, *UP, Phase.STOPPING)},
}
