"""Wheels turned by some centimetres, to see that motor and encoder agree in direction and scale."""

from collections.abc import Iterator
from statistics import fmean

from mdms_host.commissioning.doctor.findings import Finding
from mdms_host.commissioning.network import Commissioning, CommissioningError
from mdms_host.commissioning.wheels.jog import Jog
from mdms_host.commissioning.wheels.loop_margin import WheelMotor
from mdms_host.commissioning.wheels.nudge import Direction, nudge
from mdms_host.commissioning.wheels.wheel_turn import WheelError, refuse_steering, turn_wheel
from mdms_protocol import indices
from mdms_protocol.dictionary import AXES

_REFERENCES_M_S = (0.05, 0.15)
_TURN_S = 0.3
_ATTEMPTS = 5
_MV_PER_V = 1000.0
#: A wheel that resists so much less or more than its motor should is not turning as it reports.
_SCALE_LOW, _SCALE_HIGH = 0.6, 1.7


def examine_wheels(
    commissioning: Commissioning, node_id: int, motor: WheelMotor
) -> Iterator[Finding]:
    """What the wheels of a cell with such motors have.

    Raises StoppedError, SilentError, DeviceGoneError.
    """
    try:
        refuse_steering(commissioning, node_id)
    except CommissioningError as error:
        yield Finding("no-drive", str(error), (node_id,))
        return
    for axis in range(1, AXES + 1):
        try:
            yield from _examine(commissioning, node_id, axis, motor)
        except WheelError as error:
            yield Finding("no-drive", str(error), (node_id,))


def _examine(
    commissioning: Commissioning, node_id: int, axis: int, motor: WheelMotor
) -> Iterator[Finding]:
    direction = nudge(commissioning, node_id, axis)
    if direction is Direction.OPPOSED:
        yield Finding("opposed", f"axis {axis} turned against its motor", (node_id,))
    elif direction is Direction.STANDS:
        yield Finding("stands", f"axis {axis} did not move under 2 V", (node_id,))
    else:
        wanted = _resistance(motor)
        share = measured_vs_per_m(commissioning, node_id, axis) / wanted
        if not _SCALE_LOW < share < _SCALE_HIGH:
            text = f"axis {axis} needs {share:.2f} times the voltage that its motor should"
            yield Finding("scale", text, (node_id,))


def measured_vs_per_m(commissioning: Commissioning, node_id: int, axis: int) -> float:
    """Volts that a free wheel needs for each m/s that it reports, friction left out [V s/m].

    By the law of its loop, V = G (r - v), at two references. Raises WheelError.
    """
    gain = commissioning.read(node_id, indices.GAIN + (axis - 1) * indices.AXIS_OFFSET) / _MV_PER_V
    slow, fast = (_settled(commissioning, node_id, axis, each) for each in _REFERENCES_M_S)
    volts = gain * ((_REFERENCES_M_S[1] - fast) - (_REFERENCES_M_S[0] - slow))
    gained_m_s = fast - slow
    return volts / gained_m_s if gained_m_s > 0.0 else float("inf")


def _settled(commissioning: Commissioning, node_id: int, axis: int, reference_m_s: float) -> float:
    """The mean of the speeds that a wheel reports in the second half of a turn [m/s]."""
    attempts = _ATTEMPTS
    while True:
        attempts -= 1
        jog = Jog(node_id, axis, reference_m_s, _TURN_S)
        try:
            turn_wheel(commissioning, node_id, axis, jog)
        except WheelError:
            if not (attempts and jog.setpoint_missed):
                raise
        else:
            return fmean(jog.speeds_m_s[len(jog.speeds_m_s) // 2 :] or [0.0])


def _resistance(motor: WheelMotor) -> float:
    """Volts that a free wheel needs for each m/s: Ke + Rm Be / Ke (paper, eq 8) [V s/m]."""
    return motor.braking_n_s_per_m * motor.resistance_ohm / motor.force_n_per_a
