"""One wheel of one cell turned slowly, for the first sign of life: a participant on the bus.

The wheel turns while setpoints come. Should the host end in the middle, the cell misses them and
brakes by itself within its setpoint timeout (0x3000, 50 ms). A cell without power lets it coast. A
stop by another host, an emergency stop, a fault and a restart of the cell end a jog for good: it
starts the node once, and resets no fault on the way.
"""

from collections.abc import Iterator
from enum import Enum

from mdms_host.can_link.remote_cell import CUT, RemoteCell
from mdms_host.can_link.sdo_client import SdoClient, Setting
from mdms_host.commissioning.network import ForeignStops
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.emergencies import LOW_SUPPLY, code_text, error_text
from mdms_protocol.entry import MICROMETRES_PER_SECOND, steps_per_unit

#: A wheel that is to be looked at turns no faster.
SPEED_MAX_M_S = 0.2
_AXES = len(pdo.TARGET_VELOCITY.entries)
_UM_PER_M = steps_per_unit(MICROMETRES_PER_SECOND)
_SETPOINT_S = 0.01
_COMMAND_S = 0.02
_ENABLE_S = 1.0
#: Reports after which a wheel stands, or this many setpoints without one after which a cell is
#: silent. A free wheel has a tenth of its speed after two or three.
_LOOKED_AT = 30
#: A wheel that goes less than this share of its way stands.
STANDS = 0.1
#: The cell's error for a setpoint that did not come in time.
_OVERDUE = 0x8250
_TOWARDS_ENABLED: dict[int | None, int] = dict(cia402.TOWARDS_ENABLED.items())
_FAILED = (cia402.FAULT, cia402.FAULT_REACTION)
_NMT_NAMES: dict[int | None, str] = {
    nmt.INITIALISING: "starts anew",
    nmt.STOPPED: "is stopped",
    nmt.PRE_OPERATIONAL: "is pre-operational",
}


class JogPhase(Enum):
    """The subject of a jog."""

    ENABLING = "enabling"
    TURNING = "turning"
    STOPPING = "stopping"
    OVER = "over"


class Jog:
    """Turns a wheel with this speed for so long; `steer` changes both on the way.

    Axes count from 1; the other axis stays off. With `limit_mv` the cell applies no larger voltage
    until it is off again (0x2010), whatever voltage the loop asks for. A fault that stands at the
    start is reset with `resets` only. `foreign_stops` may be those of a listener that was there
    before: one of them ends it too. `failure` is why it ended early, None if it did not; `stopped`
    is whether another host, or a restart, has ended it. A cell that falls `silent`, and a wheel
    that `stands` by its encoder, end it soon: such a wheel may turn unseen. When it is over the
    cell is 'pre-operational', where no motor runs. `speeds_m_s` are the speeds that the cell has
    reported, one every `period_s` or so.
    """

    period_s = _SETPOINT_S

    def __init__(
        self,
        node_id: int,
        axis: int,
        speed_m_s: float,
        seconds: float,
        *,
        limit_mv: int | None = None,
    ) -> None:
        self.cell = RemoteCell(node_id, node_id)
        self.phase = JogPhase.ENABLING
        self.failure: str | None = None
        self.stopped = False
        self.silent = False
        self.stands = False
        self.resets = False
        self.foreign_stops = ForeignStops()
        self.wake_s = 0.0
        self.speeds_m_s: list[float] = []
        self._axis = axis
        self._speed_um_s = 0
        #: Reports that came before the present speed was given.
        self._reported_before = 0
        self._unanswered = 0
        self._seconds = seconds
        self._since_s: float | None = None
        self._started = False
        self._switched_on = False
        self._limiting = SdoClient(node_id, _limits(axis, limit_mv))
        self.steer(speed_m_s)

    @property
    def over(self) -> bool:
        """Whether the wheel has been switched off again."""
        return self.phase is JogPhase.OVER

    @property
    def distance_m(self) -> float:
        """How far the wheel has gone, as its reported speeds add up."""
        return sum(self.speeds_m_s) * self.period_s

    def steer(self, speed_m_s: float) -> None:
        """Go on with this speed. Raises ValueError above `SPEED_MAX_M_S`."""
        if not abs(speed_m_s) <= SPEED_MAX_M_S:
            raise ValueError(f"{speed_m_s:g} m/s is more than {SPEED_MAX_M_S:g} m/s")
        before, self._speed_um_s = self._speed_um_s, round(speed_m_s * _UM_PER_M)
        if self._speed_um_s != before:
            self._reported_before = len(self.speeds_m_s)

    @property
    def setpoint_missed(self) -> bool:
        """Whether the cell braked since this host, or the bus, was too slow for it."""
        return _OVERDUE in self.cell.errors.values()

    def end(self) -> None:
        """Switch the wheel off now."""
        if self.phase in (JogPhase.ENABLING, JogPhase.TURNING):
            self._enter(JogPhase.STOPPING)

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Take in a frame of the cell, or a command of another host."""
        self.foreign_stops.on_frame(frame)
        self.cell.on_frame(frame.can_id, frame.data, now_s)
        if frame.can_id == cob.SDO_RESPONSE_BASE + self.cell.node_id:
            self._limiting.on_response(frame.data)
        if frame.can_id == pdo.ACTUAL_VELOCITY.can_id(self.cell.node_id):
            speeds = self.cell.speeds_um_s
            if speeds is not None:
                self.speeds_m_s.append(speeds[self._axis - 1] / _UM_PER_M)
                self._unanswered = 0

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The frames that are due."""
        if self._since_s is None:
            self._since_s = now_s
        elapsed_s = now_s - self._since_s
        if self.phase in (JogPhase.ENABLING, JogPhase.TURNING):
            self._look_for_stops()
        match self.phase:
            case JogPhase.ENABLING:
                yield from self._enable(elapsed_s, now_s)
            case JogPhase.TURNING:
                yield from self._turn(elapsed_s)
            case JogPhase.STOPPING:
                yield from self._stop()
        self.wake_s = now_s + (_COMMAND_S if self.phase is JogPhase.ENABLING else _SETPOINT_S)

    def _enter(self, phase: JogPhase) -> None:
        self.phase, self._since_s = phase, None

    def _fail(self, reason: str) -> None:
        self.failure = self.failure or reason
        self._enter(JogPhase.STOPPING)

    def _look_for_stops(self) -> None:
        """End at a stop, and at a cell that has been operational and is not now."""
        node_id, state = self.cell.node_id, self.cell.nmt_state
        stops = self.foreign_stops
        reason = stops.reason(node_id) or stops.emergency_stop(node_id)
        if reason is None and self._started and state != nmt.OPERATIONAL:
            reason = f"it {_NMT_NAMES.get(state, 'is in no known state')}, not by this host"
        self._started = self._started or state == nmt.OPERATIONAL
        if reason is not None:
            self.stopped = True
            self._fail(reason)

    def _enable(self, elapsed_s: float, now_s: float) -> Iterator[Frame]:
        state = self._state
        if state == cia402.OPERATION_ENABLED and self._limiting.done:
            self._enter(JogPhase.TURNING)
        elif state == cia402.OPERATION_ENABLED:
            self._fail("another host has enabled the drive")
        elif elapsed_s > _ENABLE_S:
            self._fail(f"the drive does not come on: {self.cell.drive_text}{self._errors}")
        elif self.cell.nmt_state != nmt.OPERATIONAL:
            yield nmt.command(nmt.START, self.cell.node_id)
        elif state in _FAILED and not self.resets:
            self._fail(f"the axis is in fault{self._errors}")
        elif self._switched_on and state == cia402.SWITCH_ON_DISABLED:
            self._fail(f"the drive went off: {self.cell.drive_text}{self._errors}")
        else:
            yield from self._step(state, now_s)

    def _step(self, state: int | None, now_s: float) -> Iterator[Frame]:
        """The request for one step nearer to 'operation enabled'; its limit comes before."""
        word = _TOWARDS_ENABLED.get(state, cia402.SHUTDOWN)
        if word == cia402.FAULT_RESET:
            # The reset is an edge of its bit, so the bit must have been low.
            yield self._control(cia402.DISABLE_VOLTAGE)
        elif state == cia402.SWITCHED_ON:
            self._switched_on, self.resets = True, False
            if not self._limiting.done:
                yield from self._limit(now_s)
                return
        yield self._control(word)

    def _limit(self, now_s: float) -> Iterator[Frame]:
        yield from self._limiting.poll(now_s)
        if self._limiting.failure:
            reason = self._limiting.failure
            self._fail(
                f"its voltage cannot be limited: {reason}; is its firmware older? mdms flash"
            )

    def _turn(self, elapsed_s: float) -> Iterator[Frame]:
        if self._state != cia402.OPERATION_ENABLED:
            self._fail(f"the drive went off: {self.cell.drive_text}{self._errors}")
        elif elapsed_s >= self._seconds:
            self._enter(JogPhase.STOPPING)
        elif self._unanswered > _LOOKED_AT and self.speeds_m_s:
            self.silent = True
            self._fail(
                f"it has fallen silent, so nobody knows whether it is off; {CUT}, then look at its "
                "power and its plug"
            )
        elif self._is_seen_to_stand():
            self.stands = True
            self._enter(JogPhase.STOPPING)
        else:
            self._unanswered += 1
            yield from self._setpoint(self._speed_um_s)

    def _is_seen_to_stand(self) -> bool:
        """Whether the last reports add up to less than a share of the way that they should."""
        reports = self.speeds_m_s[self._reported_before :][-_LOOKED_AT:]
        way_um = STANDS * abs(self._speed_um_s) * _LOOKED_AT
        return len(reports) == _LOOKED_AT and abs(sum(reports)) * _UM_PER_M < way_um

    def _stop(self) -> Iterator[Frame]:
        """Take away all that may drive the wheel: the cell brakes it with the motor shorted.

        A loop that runs away could not lead it to rest.
        """
        yield self._control(cia402.DISABLE_VOLTAGE)
        yield nmt.command(nmt.ENTER_PRE_OPERATIONAL, self.cell.node_id)
        self.phase = JogPhase.OVER

    def _setpoint(self, speed_um_s: int) -> Iterator[Frame]:
        targets = tuple(speed_um_s if axis == self._axis else 0 for axis in range(1, _AXES + 1))
        map_ = pdo.TARGET_VELOCITY
        yield Frame(map_.can_id(self.cell.node_id), map_.encode(targets))
        yield Frame(cob.SYNC, b"")

    def _control(self, word: int) -> Frame:
        """A controlword for the axis; the other stays off."""
        off = cia402.DISABLE_VOLTAGE
        words = tuple(word if axis == self._axis else off for axis in range(1, _AXES + 1))
        return Frame(pdo.CONTROLWORD.can_id(self.cell.node_id), pdo.CONTROLWORD.encode(words))

    @property
    def _state(self) -> int | None:
        states = self.cell.drive_states
        return None if states is None else states[self._axis - 1]

    @property
    def _errors(self) -> str:
        told = [error_text(*error) for error in self.cell.errors.items()]
        if self.cell.lacks_supply and LOW_SUPPLY not in self.cell.errors.values():
            # Its emergency went out before anybody listened.
            told.append(code_text(LOW_SUPPLY))
        return "".join(f"; {text}" for text in told)


def _limits(axis: int, limit_mv: int | None) -> tuple[Setting, ...]:
    """The request that sets the voltage limit of an axis for the next time that it is enabled."""
    index = indices.TRIAL_VOLTAGE_LIMIT + (axis - 1) * indices.AXIS_OFFSET
    return () if limit_mv is None else (Setting(index, 0, limit_mv),)
