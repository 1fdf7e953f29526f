"""A bus and its cells measured for `diagnosis` to judge, by reading and listening only.

Wheels that may turn go some centimetres: motor and encoder agree in direction and scale.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf
from statistics import fmean, median

from mdms_host.can_link.link import LinkCounts
from mdms_host.clock import Clock
from mdms_host.commissioning.doctor.findings import Finding
from mdms_host.commissioning.jog import Jog
from mdms_host.commissioning.lss_master import LssError
from mdms_host.commissioning.network import (
    Commissioning,
    CommissioningError,
    Identity,
    RefusedError,
    SilentError,
)
from mdms_host.commissioning.node_ids import address, find_blank
from mdms_host.commissioning.wheel_turn import (
    Direction,
    TurnStoppedError,
    WheelError,
    nudge,
    refuse_steering,
    turn_wheel,
)
from mdms_model.loop_margin import WheelMotor
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import AXES, AXIS_OFFSET, ERROR_HISTORY

#: Twenty heartbeats at their default period.
LISTEN_S = 2.0
#: Fewer tell nothing of a clock.
_HEARTBEATS_MIN = 10
_NEIGHBOURS = 8
_PLACES = tuple(
    [(indices.PLACE, sub) for sub in range(1, 6)]
    + [(indices.NEIGHBOURS, sub) for sub in range(1, _NEIGHBOURS + 1)]
)
_OF_CELL = (
    *((indices.ERROR_REGISTER, 0), (indices.PRODUCER_TIME, 0)),
    *((indices.SUPPLY, 0), (indices.UNDERVOLTAGE_LIMIT, 0)),
    *((indices.PRESENCE, 0), (indices.SUSPECT, 0)),
    *((indices.TRAFFIC, sub) for sub in (3, 4, 5, 6)),
    *((indices.ERROR_CODE + axis * AXIS_OFFSET, 0) for axis in range(AXES)),
    *((indices.STATUSWORD + axis * AXIS_OFFSET, 0) for axis in range(AXES)),
    *_PLACES,
)
#: Entries that a cell does not tell while its wheels are on.
_AT_REST = ((indices.MEMORY, 1), (indices.MEMORY, 2))
#: Entries that firmware from USB alone does not have.
_OF_UPDATE = ((indices.FLASH_STATUS, 1), (indices.UPDATE, 8))


@dataclass(frozen=True, slots=True)
class Examined:
    """A cell: its identity, its objects by index and sub-index, past errors, and its clock.

    `period_s` is the median time from a heartbeat to the next, None if too few came.
    """

    node_id: int
    identity: Identity
    objects: Mapping[tuple[int, int], int]
    history: Sequence[int]
    period_s: float | None

    def __getitem__(self, place: tuple[int, int]) -> int:
        return self.objects[place]


@dataclass(slots=True)
class Examination:
    """All that was measured; node ids where nothing else is known.

    `serials` are those of all cells that have answered.
    """

    cells: dict[int, Examined] = field(default_factory=dict)
    strangers: dict[int, str] = field(default_factory=dict)
    silent: dict[int, str] = field(default_factory=dict)
    other_protocol: dict[int, str] = field(default_factory=dict)
    serials: list[int] = field(default_factory=list)
    blank: list[int] = field(default_factory=list)
    hidden: dict[int, int] = field(default_factory=dict)
    twins: list[int] = field(default_factory=list)
    other_host: bool = False
    counts: LinkCounts = field(default_factory=LinkCounts)


class _Heartbeats:
    """A participant that only listens: when each node's heartbeats came [s]."""

    wake_s = inf

    def __init__(self) -> None:
        self._times_s: dict[int, list[float]] = {}

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Note a heartbeat."""
        node_id = frame.can_id - cob.HEARTBEAT_BASE
        if 0 < node_id <= cob.NODE_MAX and nmt.decode_heartbeat(frame.data) is not None:
            self._times_s.setdefault(node_id, []).append(now_s)

    def poll(self, now_s: float) -> list[Frame]:
        """Nothing."""
        return []

    def period_s(self, node_id: int) -> float | None:
        """From one to the next, by the median."""
        times_s = self._times_s.get(node_id, [])
        if len(times_s) < _HEARTBEATS_MIN:
            return None
        return median(later - sooner for sooner, later in pairwise(times_s))


def examine(commissioning: Commissioning, clock: Clock, listen_s: float = LISTEN_S) -> Examination:
    """Listen, ask for all nodes, and read the statements of each cell. Raises DeviceGoneError."""
    examined = Examination()
    found = commissioning.find()
    # Questions to all nodes at once may find the transmit queue full, which is no fault.
    asked = commissioning.link.counts
    heartbeats, end_s = _Heartbeats(), clock.now_s() + listen_s
    commissioning.drive(heartbeats, lambda: clock.now_s() >= end_s)
    for node_id in found:
        _examine_node(commissioning, node_id, heartbeats.period_s(node_id), examined)
    _examine_by_lss(commissioning, examined)
    examined.other_host = commissioning.other_host
    examined.counts = commissioning.link.counts.since(asked)
    return examined


def _examine_node(
    commissioning: Commissioning, node_id: int, period_s: float | None, examined: Examination
) -> None:
    try:
        identity = commissioning.identity(node_id)
    except RefusedError as error:
        broken_off = error.code in (sdo.TOGGLE_NOT_ALTERNATED, sdo.TIMED_OUT)
        (examined.silent if broken_off else examined.strangers)[node_id] = str(error)
        return
    except CommissioningError as error:
        examined.silent[node_id] = str(error)
        return
    if not identity.is_cell:
        examined.strangers[node_id] = f"it is called {identity.name!r}"
        return
    examined.serials.append(identity.serial)
    if identity.other_protocol:
        examined.other_protocol[node_id] = identity.other_protocol
        return
    try:
        objects = {place: commissioning.read(node_id, *place) for place in _OF_CELL}
        for places in (_AT_REST, _OF_UPDATE):
            with suppress(RefusedError):
                objects |= {place: commissioning.read(node_id, *place) for place in places}
        count = commissioning.read(node_id, indices.ERROR_HISTORY)
        history = [
            commissioning.read(node_id, indices.ERROR_HISTORY, sub) & 0xFFFF
            for sub in range(1, min(count, ERROR_HISTORY) + 1)
        ]
    except CommissioningError as error:
        examined.silent[node_id] = str(error)
        return
    examined.cells[node_id] = Examined(node_id, identity, objects, history, period_s)


def _examine_by_lss(commissioning: Commissioning, examined: Examination) -> None:
    """Cells that answer by their serial numbers alone, and numbers that two answer to."""
    lss = commissioning.lss
    with suppress(LssError):
        examined.blank = [each.serial for each in find_blank(commissioning, examined.cells)]
    known = [*examined.serials, *examined.blank]
    examined.twins = sorted({serial for serial in known if known.count(serial) > 1})
    for serial in lss.find_beside(known):
        try:
            lss.select(address(serial))
            examined.hidden[serial] = lss.pending_node_id()
        except LssError:
            examined.twins.append(serial)
        finally:
            lss.leave()


_REFERENCES_M_S = (0.05, 0.15)
_TURN_S = 0.3
_ATTEMPTS = 5
_MV_PER_V = 1000.0
#: A wheel that resists so much less or more than its motor should is not turning as it reports.
_SCALE_LOW, _SCALE_HIGH = 0.6, 1.7


def examine_wheels(
    commissioning: Commissioning, node_id: int, motor: WheelMotor
) -> Iterator[Finding]:
    """The parameters of the wheels of a cell with such motors.

    Raises TurnStoppedError, DeviceGoneError.
    """
    try:
        refuse_steering(commissioning, node_id)
        for axis in range(1, AXES + 1):
            try:
                yield from _examine(commissioning, node_id, axis, motor)
            except WheelError as error:
                yield Finding("no-drive", str(error), (node_id,))
        if node_id in commissioning.foreign_stops.restarted:
            text = "it has restarted meanwhile; look at its supply and its plug"
            yield Finding("no-drive", text, (node_id,))
    except TurnStoppedError:
        raise
    except SilentError as error:
        yield Finding("silent-node", str(error), (node_id,))
    except CommissioningError as error:
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
