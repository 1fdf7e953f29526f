"""The coordinator's life as one table of transitions."""

from enum import StrEnum


class Phase(StrEnum):
    """What the coordinator is doing."""

    WAITING = "waiting for the cells"
    IDENTIFYING = "identifying the cells"
    CONFIGURING = "writing settings"
    STARTING = "starting the cells"
    ENABLING = "enabling the drives"
    RUNNING = "running"
    STOPPING = "stopping"
    FAILING = "stopping after a fault"
    STOPPED = "stopped"
    FAILED = "stopped after a fault"


class Signal(StrEnum):
    """What may end a phase."""

    DONE = "done"
    STOP = "stop"
    FAULT = "fault"


BRING_UP = (
    *(Phase.WAITING, Phase.IDENTIFYING, Phase.CONFIGURING),
    *(Phase.STARTING, Phase.ENABLING),
)
STOPPED = (Phase.STOPPED, Phase.FAILED)

TRANSITIONS: dict[tuple[Phase, Signal], Phase] = {
    (Phase.WAITING, Signal.DONE): Phase.IDENTIFYING,
    (Phase.IDENTIFYING, Signal.DONE): Phase.CONFIGURING,
    (Phase.CONFIGURING, Signal.DONE): Phase.STARTING,
    (Phase.STARTING, Signal.DONE): Phase.ENABLING,
    (Phase.ENABLING, Signal.DONE): Phase.RUNNING,
    (Phase.STOPPING, Signal.DONE): Phase.STOPPED,
    (Phase.FAILING, Signal.DONE): Phase.FAILED,
    **{(phase, Signal.STOP): Phase.STOPPING for phase in (*BRING_UP, Phase.RUNNING)},
    **{
        (phase, Signal.FAULT): Phase.FAILING for phase in (*BRING_UP, Phase.RUNNING, Phase.STOPPING)
    },
}
