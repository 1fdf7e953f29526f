"""Runs a coordinator on a real or served array, from bring-up to an orderly end."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from mdms_host.can_link.delays import punctual
from mdms_host.can_link.link import AnyLink, DeviceGoneError, LinkCounts, drive
from mdms_host.can_link.remote_cell import BROKEN_OFF
from mdms_host.clock import Clock
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import TROUBLED, Phase
from mdms_model.log import LOG
from mdms_model.participant import Participant
from mdms_protocol.codecs import nmt

#: Takes the time of an event [s], its kind, and its text.
OnEvent = Callable[[float, str, str], object]
_STEERED = frozenset((Phase.ENABLING, Phase.RUNNING))


class Ending(StrEnum):
    """How a run on an array has ended."""

    DONE = "done"
    TIME_LIMIT = "time limit"
    STUCK = "stuck"
    FAULT = "fault"
    NO_CELLS = "no cells"
    INTERRUPTED = "interrupted"
    DEVICE_GONE = "device gone"


@dataclass(frozen=True, slots=True)
class Operation:
    """A run that has ended: how, after how long [s], with which fault and which counts of its bus.

    A fault names the parts that were held up at that time. `interrupt` is the cause of an early
    end, None without one.
    """

    ending: Ending
    duration_s: float
    fault: str | None
    link: LinkCounts
    interrupt: KeyboardInterrupt | None = None


def operate(
    coordinator: Coordinator,
    link: AnyLink,
    clock: Clock,
    limit_s: float | None = None,
    on_event: OnEvent = lambda _time_s, _kind, _text: None,
    *,
    participant: Participant | None = None,
    interrupted: Callable[[], KeyboardInterrupt | None] = lambda: None,
) -> Operation:
    """Run the program until it is finished, for `limit_s` at most, then turn the array off.

    `participant` is on the bus in the coordinator's place, if given, and drives it: a recorder.
    `on_event(time_s, kind, text)` is called for events of the coordinator, and for incidents of the
    link, as they happen.
    `interrupted` is polled between two cycles. It returns the interrupt (Ctrl-C) that ends the run
    early, but in order. Any error ends the run in order, too, and is raised when the array is off.
    A KeyboardInterrupt that is raised may leave a cycle half done. Then all cells are taken out of
    'operational', and nothing else is done. If one device of several is gone, the cells on the
    others are stopped in order.

    Raises DeviceGoneError.
    """
    with punctual(clock):
        return _operate(
            coordinator,
            participant or coordinator,
            link,
            clock,
            limit_s=limit_s,
            on_event=on_event,
            interrupted=interrupted,
        )


def _operate(
    coordinator: Coordinator,
    participant: Participant,
    link: AnyLink,
    clock: Clock,
    *,
    limit_s: float | None,
    on_event: OnEvent,
    interrupted: Callable[[], KeyboardInterrupt | None],
) -> Operation:
    start_s = clock.now_s()
    watch = _Watch(coordinator, link, clock, on_event)

    def running() -> bool:
        watch.look()
        late = limit_s is not None and clock.now_s() - start_s > limit_s
        over = coordinator.stopped or coordinator.finished or coordinator.stuck is not None
        return not (over or late or interrupted())

    try:
        drive(participant, link, clock, lambda: not running())
    except KeyboardInterrupt:
        all_off(link)
        raise
    except DeviceGoneError:
        if link.leave_gone():
            _turn_off(coordinator, participant, link, clock)
        watch.look()
        raise
    except BaseException:
        _turn_off(coordinator, participant, link, clock)
        raise
    finished, interrupt = coordinator.finished, interrupted()
    _turn_off(coordinator, participant, link, clock)
    watch.look()
    ending = _ending(coordinator, interrupt is not None, finished, limit_s)
    fault = watch.fault
    if ending is Ending.NO_CELLS and fault is None:
        fault = f"no cell was heard within the limit of {limit_s:g} s; is the bus connected?"
    return Operation(ending, clock.now_s() - start_s, fault, link.counts, interrupt)


class _Watch:
    """Reports the events of a run, and finds the part that was held up when it fails."""

    def __init__(
        self,
        coordinator: Coordinator,
        link: AnyLink,
        clock: Clock,
        on_event: OnEvent,
    ) -> None:
        self.fault: str | None = None
        self._held_up = ""
        self._coordinator = coordinator
        self._link = link
        self._clock = clock
        self._on_event = on_event
        self._reported = self._incidents = 0
        self._steered = False
        self._held = False

    def look(self) -> None:
        """Report new events."""
        if self._coordinator.fault:
            if self.fault is None:
                self._held_up = self._delay()
            # Its end adds the cells that have not confirmed it.
            self.fault = self._coordinator.fault + self._held_up
        self._steered |= self._coordinator.phase in _STEERED
        self._look_at_hold()
        events, count = self._coordinator.events_since(self._reported)
        self._reported = count - len(events)
        for time_s, text in events:
            self._reported += 1
            self._on_event(time_s, "coordinator", text)
        for time_s, text in self._link.incidents[self._incidents :]:
            self._incidents += 1
            self._on_event(time_s, "link", text)

    def _look_at_hold(self) -> None:
        """Report the part that was held up when all parcels begin to be held, if any."""
        before, self._held = self._held, self._coordinator.phase in TROUBLED
        if self._held and not before and (delay := self._delay()):
            self._on_event(self._clock.now_s(), "coordinator", f"held up{delay}")

    def _delay(self) -> str:
        """The part that was held up, in brackets.

        Before setpoints are due in time, heartbeats alone decide.
        """
        delays, now_s = self._link.delays, self._clock.now_s()
        reason = delays.reason(now_s) if self._steered else delays.slow_reason(now_s)
        return f" ({reason})" if reason else ""


def _turn_off(
    coordinator: Coordinator, participant: Participant, link: AnyLink, clock: Clock
) -> None:
    """Stop the array in order; where that fails, take all cells out of 'operational' at once.

    Cells are stopped on all buses whose devices are there. Raises DeviceGoneError after that.
    """
    coordinator.stop()
    gone: DeviceGoneError | None = None
    while not coordinator.stopped:
        try:
            drive(participant, link, clock, lambda: coordinator.stopped)
        except DeviceGoneError as error:
            gone = gone or error
            if not link.leave_gone():
                raise
        except BaseException:
            all_off(link)
            raise
    if gone is not None:
        raise gone


def all_off(link: AnyLink) -> None:
    """Take all cells out of 'operational'; nobody confirms that, so it is said three times."""
    LOG.warning(BROKEN_OFF)
    for _ in range(3):
        link.send(nmt.command(nmt.ENTER_PRE_OPERATIONAL))


def _ending(
    coordinator: Coordinator, interrupted: bool, finished: bool, limit_s: float | None
) -> Ending:
    present = any(cell.last_heartbeat_s is not None for cell in coordinator.cells)
    if coordinator.fault:
        return Ending.FAULT if present else Ending.NO_CELLS
    if interrupted:
        return Ending.INTERRUPTED
    if not present:
        return Ending.NO_CELLS
    if finished or coordinator.endless:
        return Ending.DONE
    return Ending.TIME_LIMIT if coordinator.stuck is None else Ending.STUCK
