"""A wheel turned by `jog` and measured by its encoder, on a bus where nobody else drives.

A nudge shows whether motor and encoder agree. The pushes begin with a quarter of a volt and double
until the wheel moves. Each has a voltage limit of its own (0x2010), so that a wheel whose loop runs
away does so slowly. The cell itself ends that limit when the axis goes off: no setting is changed,
however this ends.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from mdms_host.commissioning.jog import Jog
from mdms_host.commissioning.network import (
    Commissioning,
    CommissioningError,
    SilentError,
    operational_text,
)
from mdms_protocol import indices
from mdms_protocol.codecs import cia402, nmt
from mdms_protocol.emergencies import STOPPED_MEANWHILE, code_text

#: Bit of 0x607E: motor and encoder are mounted the other way round.
REVERSED = 0x40
#: Voltage limit over the voltage that a wheel's speed needs, or over its runaway watch.
_ROOM = 1.2
#: Faults of which nothing is left but that who drove the wheel has fallen silent.
_SILENCES = (0x8130, 0x8250)
#: Those that a person's command resets: a stop before it does not bind it.
_LEFT_BEHIND = (*_SILENCES, STOPPED_MEANWHILE)
#: A wheel that is braked stands within a few of them; one with no bridge may roll on.
_LOOKS = 50


class BusyError(CommissioningError):
    """Somebody else may be driving the cells."""


class WheelError(CommissioningError):
    """A wheel could not be turned; the message has the cell's reason."""


class TurnStoppedError(CommissioningError):
    """Another host or an emergency stop has stopped the cell, or it has restarted.

    Nothing is to be turned any more.
    """


@dataclass(frozen=True, slots=True)
class Turn:
    """How far a wheel went by its encoder [m; along its own direction], and how fast at most."""

    distance_m: float
    peak_m_s: float


def refuse_busy(commissioning: Commissioning, node_ids: list[int]) -> None:
    """Raises BusyError where another host is at work, or one of these nodes is operational."""
    if commissioning.other_host:
        raise BusyError("another host runs the array; end it first, for it moves wheels too")
    running = [node for node in node_ids if commissioning.states.get(node) == nmt.OPERATIONAL]
    if running:
        raise BusyError(operational_text(running))


def refuse_steering(commissioning: Commissioning, node_id: int) -> None:
    """Raises BusyError for a cell that leads its wheels by itself and takes no setpoints."""
    if commissioning.read(node_id, indices.CONTROL):
        raise BusyError(
            f"node {node_id} steers by itself; first: mdms configure set control=0 --node {node_id}"
        )


def limit_for(commissioning: Commissioning, node_id: int, axis: int, speed_m_s: float) -> int:
    """The voltage [mV] that turning up to a speed [m/s] needs, and by which a runaway is noticed.

    A wheel whose motor is wired against its encoder goes no faster than by this.
    """
    offset = (axis - 1) * indices.AXIS_OFFSET
    needed_mv = commissioning.read(node_id, indices.GAIN + offset) * abs(speed_m_s)
    watched_mv = commissioning.read(node_id, indices.REVERSAL_VOLTAGE + offset)
    return max(1, round(_ROOM * max(needed_mv, watched_mv)))


def turn_wheel(
    commissioning: Commissioning,
    node_id: int,
    axis: int,
    jog: Jog,
    over: Callable[[], object] = lambda: None,
    *,
    again: bool = False,
) -> Turn:
    """Turn a wheel to the jog's end, and measure; `over` is called often on the way.

    However it ends early, the cell is sent to 'pre-operational', where no motor runs. A fault that
    stands is not reset, unless `jog.resets`, or it says only that an earlier host fell silent. A
    stop after that silence counts if this is done `again`, for the host was this one.
    Raises WheelError, StoppedError, SilentError, DeviceGoneError.
    """
    before = _position_m(commissioning, node_id, axis)
    jog.resets = jog.resets or _fell_silent(commissioning, node_id, axis, again)

    jog.foreign_stops = commissioning.foreign_stops
    _ask_supplies(commissioning, node_id)

    def looked() -> bool:
        over()
        return jog.over

    try:
        commissioning.drive(jog, looked)
    finally:
        if not jog.over:
            commissioning.command(nmt.ENTER_PRE_OPERATIONAL, node_id)
    if jog.stopped:
        raise TurnStoppedError(f"node {node_id} was stopped: {jog.failure}; its wheels are off")
    if jog.silent:
        raise SilentError(f"node {node_id}, axis {axis}: {jog.failure}")
    if jog.failure:
        raise WheelError(f"node {node_id}, axis {axis}: {jog.failure}")
    after = _rest_m(commissioning, node_id, axis)
    return Turn(after - before, max(map(abs, jog.speeds_m_s), default=0.0))


def _ask_supplies(commissioning: Commissioning, node_id: int) -> None:
    """Have all other cells that were heard tell whether an emergency stop is pressed by now."""
    stops = commissioning.foreign_stops
    for other in stops.heard:
        if other == node_id:
            continue
        try:
            stops.note_supply(other, commissioning.read(other, indices.ERROR_REGISTER))
        except CommissioningError:
            # It has gone, or is no cell. The next push is not to wait for it again.
            stops.forget(other)


def _fell_silent(commissioning: Commissioning, node_id: int, axis: int, again: bool) -> bool:
    """Whether an axis is in fault only since who drove it fell silent, before a stop or not.

    Raises WheelError for any other fault.
    """
    offset = (axis - 1) * indices.AXIS_OFFSET
    state = cia402.state(commissioning.read(node_id, indices.STATUSWORD + offset))
    if state != cia402.FAULT:
        return False
    code = commissioning.read(node_id, indices.ERROR_CODE + offset)
    if code not in (_SILENCES if again else _LEFT_BEHIND):
        raise WheelError(
            f"node {node_id}, axis {axis} is in fault, {code_text(code)}; remove the cause, then: "
            f"mdms jog --node {node_id} --axis {axis} --reset"
        )
    return True


def _rest_m(commissioning: Commissioning, node_id: int, axis: int) -> float:
    """Where the encoder is once it counts no more, or after a few looks."""
    position_m = _position_m(commissioning, node_id, axis)
    for _ in range(_LOOKS):
        before_m, position_m = position_m, _position_m(commissioning, node_id, axis)
        if position_m == before_m:
            break
    return position_m


def _position_m(commissioning: Commissioning, node_id: int, axis: int) -> float:
    """Where the encoder is, along the wheel's own direction [m from where it was switched on]."""
    offset = (axis - 1) * indices.AXIS_OFFSET
    counts = commissioning.read(node_id, indices.POSITION + offset)
    resolution = commissioning.read(node_id, indices.RESOLUTION + offset)
    polarity = commissioning.read(node_id, indices.POLARITY + offset)
    return (-counts if polarity & REVERSED else counts) / resolution


#: References [m/s] and times [s] of the pushes; times the gain (13 V s/m) they are 0.26 to 2.1 V.
#: A wheel whose encoder is dead goes 4 cm by all of them.
_PUSHES = ((0.02, 0.06), (0.04, 0.03), (0.08, 0.02), (0.16, 0.02))
#: A push is made again where setpoints came too late for the cell, as on a busy machine.
_ATTEMPTS = 5
#: A push ends when the wheel has gone so far as its reports add up, and it counts as moved.
_ENOUGH_M = 0.003
_MOVED_M = 0.0005


class Direction(Enum):
    """An encoder's report of a wheel that its motor pushes forward."""

    AGREES = "agrees"
    OPPOSED = "opposed"
    STANDS = "stands"


def nudge(commissioning: Commissioning, node_id: int, axis: int) -> Direction:
    """Push a wheel forward until its encoder moves.

    Raises WheelError for a drive that does not come on or goes to fault, StoppedError,
    SilentError, RefusedError.
    """
    offset = (axis - 1) * indices.AXIS_OFFSET
    gain_mv_s_per_m = commissioning.read(node_id, indices.GAIN + offset)
    for reference_m_s, push_s in _PUSHES:
        limit_mv = max(1, round(_ROOM * gain_mv_s_per_m * reference_m_s))
        moved_m = _push(commissioning, node_id, axis, reference_m_s, push_s, limit_mv)
        if abs(moved_m) >= _MOVED_M:
            return Direction.AGREES if moved_m > 0 else Direction.OPPOSED
    return Direction.STANDS


def _push(  # noqa: PLR0917
    commissioning: Commissioning,
    node_id: int,
    axis: int,
    reference_m_s: float,
    push_s: float,
    limit_mv: int,
) -> float:
    """How far the encoder went [m]."""
    attempts = _ATTEMPTS
    while True:
        attempts -= 1
        jog = Jog(node_id, axis, reference_m_s, push_s, limit_mv=limit_mv)

        def look(jog: Jog = jog) -> None:
            if abs(jog.distance_m) >= _ENOUGH_M:
                jog.end()

        try:
            again = attempts < _ATTEMPTS - 1
            return turn_wheel(commissioning, node_id, axis, jog, look, again=again).distance_m
        except WheelError:
            if not jog.setpoint_missed:
                raise
            # A wheel that has run away by then has shown which way.
            if abs(jog.distance_m) >= _MOVED_M:
                return jog.distance_m
            if not attempts:
                raise
