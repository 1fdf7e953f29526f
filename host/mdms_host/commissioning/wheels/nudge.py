"""Whether a wheel's motor and encoder agree: it is nudged by a few millimetres, and watched.

The pushes begin with a quarter of a volt and double until the wheel moves. Each has a voltage limit
of its own (0x2010), so that a wheel whose loop runs away does so slowly. The cell itself ends that
limit when the axis goes off: no setting is changed, however this ends.
"""

from enum import Enum

from mdms_host.commissioning.network import Commissioning
from mdms_host.commissioning.wheels.jog import Jog
from mdms_host.commissioning.wheels.wheel_turn import WheelError, turn_wheel
from mdms_protocol import indices

#: References [m/s] and times [s] of the pushes; times the gain (13 V s/m) they are 0.26 to 2.1 V.
#: A wheel whose encoder is dead goes 4 cm by all of them.
_PUSHES = ((0.02, 0.06), (0.04, 0.03), (0.08, 0.02), (0.16, 0.02))
#: A push is made again where setpoints came too late for the cell, as on a busy machine.
_ATTEMPTS = 5
#: A push ends when the wheel has gone so far as its reports add up, and it counts as moved.
_ENOUGH_M = 0.003
_MOVED_M = 0.0005
#: What a push may reach beyond its reference times the gain.
_ROOM = 1.2


class Direction(Enum):
    """What an encoder shows of a wheel that its motor pushes forward."""

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
            return turn_wheel(commissioning, node_id, axis, jog, look).distance_m
        except WheelError:
            if not jog.setpoint_missed:
                raise
            # A wheel that has run away by then has shown which way.
            if abs(jog.distance_m) >= _MOVED_M:
                return jog.distance_m
            if not attempts:
                raise
