"""Arrays to try the host on: a kinematic one in virtual time, and firmware cells in real time."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from math import expm1
from threading import Event, Thread

import can
import numpy as np
import pytest
from tests.virtual_array import StandingArray, VirtualTime, virtual_time

from mdms_cell.canopen.objects import Objects
from mdms_cell.canopen.sdo_server import SdoServer
from mdms_cell.perception.sensors import Presence
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.network import Commissioning
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.estimation.footprint import Rectangle
from mdms_host.layout import Layout
from mdms_protocol import indices, pdo, record, signature
from mdms_protocol.codecs import cia402, cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank

STEP_S = 0.001
DROOP = 0.775
#: Wheels under 2 kg take it along with so much of the difference in a second.
STIFFNESS_PER_S = 30.0

#: The next state after a controlword (CiA 402-2, the transitions that matter here).
NEXT = {
    (cia402.SWITCH_ON_DISABLED, cia402.SHUTDOWN): cia402.READY_TO_SWITCH_ON,
    (cia402.READY_TO_SWITCH_ON, cia402.SWITCH_ON): cia402.SWITCHED_ON,
    (cia402.SWITCHED_ON, cia402.ENABLE_OPERATION): cia402.OPERATION_ENABLED,
    (cia402.OPERATION_ENABLED, cia402.QUICK_STOP): cia402.SWITCH_ON_DISABLED,
}


@dataclass
class KinematicCell:
    """Speaks for one cell; its wheels have no dynamics."""

    node_id: int
    boots_s: float = 0.05
    dies_s: float = np.inf
    stuck: bool = False
    nmt_state: int = nmt.INITIALISING
    states: list[int] = field(default_factory=lambda: [cia402.SWITCH_ON_DISABLED] * 2)
    waiting_um_s: tuple[int, ...] = (0, 0)
    target_um_s: tuple[int, ...] = (0, 0)
    status: tuple[int, ...] | None = None
    status_s: float = 0.0
    heartbeat_s: float = 0.0
    sensors: Presence = field(default_factory=Presence)
    writes: list[bytes] = field(default_factory=list)
    reads: list[bytes] = field(default_factory=list)
    #: How many settings had been written when the period of the status was read.
    settled: int = -1
    period_s: float = 0.0
    objects: Objects = field(default_factory=Objects)

    def __post_init__(self) -> None:
        """The object dictionary is the firmware's, with its settings at their defaults."""
        self.objects.reset(self.node_id, record.FROM_NODE)
        read = partial(signature.of, self.objects.data)
        self.objects.tie(indices.SIGNATURE, 0, read=read)

    def alive(self, now_s: float) -> bool:
        return self.boots_s <= now_s < self.dies_s

    def on_frame(self, frame: Frame, speeds_um_s: tuple[int, ...]) -> list[Frame]:
        if frame.can_id == cob.NMT and frame.data[1] in (0, self.node_id):
            self.nmt_state = nmt.TRANSITIONS[frame.data[0]]
            return [nmt.heartbeat(self.node_id, self.nmt_state)]
        if frame.can_id == cob.SYNC and self.nmt_state == nmt.OPERATIONAL:
            self.target_um_s = self.waiting_um_s
            data = pdo.ACTUAL_VELOCITY.encode(speeds_um_s)
            return [Frame(pdo.ACTUAL_VELOCITY.can_id(self.node_id), data)]
        if frame.can_id == pdo.TARGET_VELOCITY.can_id(self.node_id):
            self.waiting_um_s = pdo.TARGET_VELOCITY.decode(frame.data)
        if frame.can_id == pdo.CONTROLWORD.can_id(self.node_id) and not self.stuck:
            words = pdo.CONTROLWORD.decode(frame.data)
            self.states = [NEXT.get(pair, pair[0]) for pair in zip(self.states, words, strict=True)]
        if frame.can_id == cob.SDO_REQUEST_BASE + self.node_id:
            writes = frame.data[0] & sdo.SPECIFIER == sdo.DOWNLOAD
            (self.writes if writes else self.reads).append(frame.data)
            answers: list[bytes] = []
            SdoServer(self.objects, answers.append).on_request(frame.data)
            return [Frame(cob.SDO_RESPONSE_BASE + self.node_id, answer) for answer in answers]
        return []

    def poll(self, now_s: float, presence: int) -> list[Frame]:
        frames = []
        if self.heartbeat_s <= now_s:
            frames.append(nmt.heartbeat(self.node_id, self.nmt_state))
            if self.nmt_state == nmt.INITIALISING:
                self.nmt_state = nmt.PRE_OPERATIONAL
            self.heartbeat_s = now_s + 0.1
        if self.settled != len(self.writes):
            self.settled = len(self.writes)
            self.sensors.debounce_ms = self.objects.number(indices.PRESENCE_DEBOUNCE)
            self.period_s = self.objects.number(indices.TPDO_PARAMETERS + 1, 5) * 1e-3
        self.sensors.step(presence, round(now_s * 1e3))
        words = (state | cia402.VOLTAGE_ENABLED for state in self.states)
        status = (*words, self.sensors.bits)
        due = status != self.status or (self.period_s and now_s >= self.status_s + self.period_s)
        if self.nmt_state == nmt.OPERATIONAL and due:
            self.status, self.status_s = status, now_s
            frames.append(Frame(pdo.STATUS.can_id(self.node_id), pdo.STATUS.encode(status)))
        return frames


class RollingArray:
    """One parcel that the wheels under it take along, as far as a rigid body can follow them all.

    It has the mass of a box of 2 kg, without the grip of its wheels having a limit.

    Frames to the host that are `lost` do not arrive; the host is not polled before `stalled_s`.
    """

    def __init__(
        self,
        layout: Layout,
        footprint: Rectangle,
        pose: tuple[float, float, float],
        *,
        latency_s: float = 0.002,
        speed_error: float = 0.0,
        noise_m_s: float = 0.0,
        seed: int = 1,
    ) -> None:
        self.layout = layout
        self.footprint = footprint
        self.pose = np.array(pose)
        self.now_s = 0.0
        self.stalled_s = 0.0
        self.lost: Callable[[Frame], bool] = lambda _frame: False
        self.cells = [KinematicCell(node_id) for node_id in layout.node_ids]
        self._latency_s = latency_s
        self._speed_error = speed_error
        self._noise_m_s = noise_m_s
        self._random = np.random.default_rng(seed)
        self._speeds_m_s = np.zeros(len(layout.wheel_cells))
        self._twist = np.zeros(3)
        self._on_wire: list[tuple[float, bool, Frame]] = []

    def inject(self, frame: Frame) -> None:
        self._on_wire.append((self.now_s, True, frame))

    def run(
        self,
        coordinator: Coordinator,
        until_s: float,
        done: Callable[[], bool] = lambda: False,
    ) -> None:
        while self.now_s < until_s and not done():
            self._deliver(coordinator)
            if max(coordinator.wake_s, self.stalled_s) <= self.now_s + 1e-9:
                self._queue(coordinator.poll(self.now_s), False)
            self._move()
            presence = self.presence()
            for cell, bits in zip(self.cells, presence, strict=True):
                if cell.alive(self.now_s):
                    self._queue(cell.poll(self.now_s, int(bits)), True)
            self.now_s = round(self.now_s + STEP_S, 6)

    def presence(self) -> np.ndarray:
        sensors_m = self.layout.sensor_positions_m
        covered = self.footprint.distance_m(sensors_m.reshape(-1, 2), self.pose) < 0
        return covered.reshape(sensors_m.shape[:2]) @ (1 << np.arange(sensors_m.shape[1]))

    def _queue(self, frames: list[Frame], to_host: bool) -> None:
        self._on_wire += [(self.now_s + self._latency_s, to_host, frame) for frame in frames]

    def _deliver(self, coordinator: Coordinator) -> None:
        due = [item for item in self._on_wire if item[0] <= self.now_s + 1e-9]
        self._on_wire = [item for item in self._on_wire if item[0] > self.now_s + 1e-9]
        for _, to_host, frame in due:
            if to_host:
                if not self.lost(frame):
                    coordinator.on_frame(frame, self.now_s)
                continue
            told_um_s = self._told_um_s() if frame.can_id == cob.SYNC else None
            for number, cell in enumerate(self.cells):
                speeds_um_s = () if told_um_s is None else tuple(told_um_s[number])
                # Frames without a node id are for all.
                if frame.can_id & cob.NODE_MAX in (0, cell.node_id) and cell.alive(self.now_s):
                    self._queue(cell.on_frame(frame, speeds_um_s), True)

    def _told_um_s(self) -> list[list[int]]:
        noise = self._random.normal(0.0, self._noise_m_s, self._speeds_m_s.shape)
        told_m_s = self._speeds_m_s * (1 + self._speed_error) + noise
        return np.rint(told_m_s * 1e6).astype(int).reshape(-1, 2).tolist()

    def _move(self) -> None:
        enabled = [cell.states == [cia402.OPERATION_ENABLED] * 2 for cell in self.cells]
        targets = np.array([cell.target_um_s for cell in self.cells]) * 1e-6 * DROOP
        self._speeds_m_s = (targets * np.array(enabled)[:, None]).ravel()
        under = self.footprint.distance_m(self.layout.wheel_positions_m, self.pose) < 0
        jacobian = self.layout.surface_jacobian(*self.pose[:2])[under]
        twist = np.linalg.lstsq(jacobian, self._speeds_m_s[under], rcond=None)[0]
        self._twist += (twist - self._twist) * -expm1(-STIFFNESS_PER_S * STEP_S)
        self._speeds_m_s[under] = jacobian @ self._twist
        self.pose = self.pose + self._twist * STEP_S


@pytest.fixture
def kinematic_cell() -> type[KinematicCell]:
    return KinematicCell


@pytest.fixture
def rolling_array() -> type[RollingArray]:
    return RollingArray


class ServedCells:
    """Firmware cells on a python-can bus in real time; nothing lies on them, no wheel turns."""

    def __init__(self, channel: str, node_ids: tuple[int, ...]) -> None:
        self.channel = channel
        self.bank = PythonBank(node_ids)
        self._node_ids = node_ids
        self._bus = can.Bus(channel, interface="virtual")
        self._over = Event()
        self._counts = np.zeros((len(node_ids), 2), np.int32)
        self._presence = np.zeros(len(node_ids), np.uint8)
        self._boot()
        self._thread = Thread(target=self._serve)
        self._thread.start()

    def open(self) -> can.BusABC:
        return can.Bus(self.channel, interface="virtual")

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._bus.shutdown()

    def _boot(self) -> None:
        """Cells, and code that is compiled at its first use, are ready when the bus is opened."""
        self.bank.tick(self._counts, np.zeros_like(self._counts), self._presence)
        named = (node_id for node_id in self._node_ids if node_id != cob.NODE_NONE)
        waiting = {cob.HEARTBEAT_BASE + node_id for node_id in named}
        while waiting:
            self.bank.tick(self._counts, np.zeros_like(self._counts), self._presence)
            for cell in range(len(self._node_ids)):
                waiting -= {frame.can_id for frame in self.bank.collect(cell)}

    def _serve(self) -> None:
        clock, ticks = MonotonicClock(), 0
        while not self._over.is_set():
            message = self._bus.recv(0.001)
            while message is not None:
                self._deliver(Frame(message.arbitration_id, bytes(message.data)))
                message = self._bus.recv(0)
            while ticks < clock.now_s() * 1000:
                self.bank.tick(self._counts, np.zeros_like(self._counts), self._presence)
                ticks += 1
            self._collect()

    def _deliver(self, frame: Frame) -> None:
        for cell in range(len(self._node_ids)):
            self.bank.deliver(cell, frame)

    def _collect(self) -> None:
        for cell in range(len(self._node_ids)):
            for frame in self.bank.collect(cell):
                self._bus.send(
                    can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False)
                )


@pytest.fixture
def served_cells(request: pytest.FixtureRequest) -> Iterator[ServedCells]:
    cells = ServedCells(request.node.nodeid, getattr(request, "param", (1, 2, 3)))
    yield cells
    cells.close()


@pytest.fixture
def standing_cells(request: pytest.FixtureRequest) -> Iterator[VirtualTime]:
    """The same cells in virtual time; who opens a bus finds them there."""
    node_ids = getattr(request, "param", (1, 2, 3))
    with virtual_time(StandingArray(PythonBank(node_ids), len(node_ids))) as time:
        yield time


@pytest.fixture
def commissioning(standing_cells: VirtualTime) -> Iterator[Commissioning]:
    with Commissioning(None, MonotonicClock()) as ready:
        yield ready
