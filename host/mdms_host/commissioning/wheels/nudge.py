"""Whether a wheel's motor and encoder agree: it is nudged by a few millimetres, and watched.

The pushes begin with a quarter of a volt and double until the wheel moves. The voltage limit of
the axis is lowered for each, so that a wheel whose loop runs away does so slowly.
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
    """Push a wheel forward until its encoder moves; the axis's voltage limit is put back.

    Raises WheelError for a drive that does not come on, SilentError, RefusedError.
    """
    offset = (axis - 1) * indices.AXIS_OFFSET
    limit = indices.VOLTAGE_LIMIT + offset
    before_mv = commissioning.read(node_id, limit)
    gain_mv_s_per_m = commissioning.read(node_id, indices.GAIN + offset)
    try:
        for reference_m_s, push_s in _PUSHES:
            push_mv = round(_ROOM * gain_mv_s_per_m * reference_m_s)
            commissioning.write(node_id, limit, 0, min(push_mv, before_mv))
            moved_m = _push(commissioning, node_id, axis, reference_m_s, push_s)
            if abs(moved_m) >= _MOVED_M:
                return Direction.AGREES if moved_m > 0 else Direction.OPPOSED
        return Direction.STANDS
    finally:
        commissioning.write(node_id, limit, 0, before_mv)


def _push(
    commissioning: Commissioning, node_id: int, axis: int, reference_m_s: float, push_s: float
) -> float:
    """How far the encoder went [m]."""
    attempts = _ATTEMPTS
    while True:
        attempts -= 1
        jog = Jog(node_id, axis, reference_m_s, push_s)
        gone = _Gone(jog)
        try:
            return turn_wheel(commissioning, node_id, axis, jog, gone.look).distance_m
        except WheelError:
            # Whatever the cell made of it, a wheel that has run away has shown which way.
            if abs(gone.distance_m) >= _MOVED_M:
                return gone.distance_m
            if not (attempts and jog.setpoint_missed):
                raise


class _Gone:
    """Adds up how far a wheel goes by its reported speeds, and ends the jog in time."""

    def __init__(self, jog: Jog) -> None:
        self.distance_m = 0.0
        self._jog = jog
        self._counted = 0

    def look(self) -> None:
        """Count the reports since the last look."""
        new = self._jog.reports - self._counted
        self._counted += new
        self.distance_m += new * self._jog.speed_m_s * self._jog.period_s
        if abs(self.distance_m) >= _ENOUGH_M:
            self._jog.end()
