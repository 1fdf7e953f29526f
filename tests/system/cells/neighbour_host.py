"""A small host for cells that steer by themselves: brings them up, gives programs, and listens.

It writes places, switches drives on, gives SYNC and its heartbeat, sends each parcel's pages a few
times, and nothing afterwards. Its reports are those that any listener on the bus could make.
"""

import math
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from mdms_array.host import layout_of
from mdms_host.layout import Layout
from mdms_host.places import all_values
from mdms_model.run.record import Record
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.neighbours import frames as wire
from mdms_sim.simulation import Simulation, addresses_of, open_bank

BEAT_S = 0.01
HOST_NODE = 127
#: The code of an emergency about a neighbour.
SUSPICION = 0xFF01
_BEGIN_S = 0.3
_STEP_S = 0.05
#: At rest for so long it is over; at their goals, where nothing more is to come, for so long.
_STILL_S = 1.5
_ARRIVED_S = 0.6
_HELD_S = 1.0
#: The code of an emergency about the host's heartbeat.
_HOST_LOST = 0x8130
_HEARTBEAT_BEATS = 2
_CONSUMER_MS = 75
_REPEAT_MS = 200
#: Sub-index of the lease: whether cells give SYNC where nobody else does.
_TAKEOVER = 3
_PAGES_BEATS = (20, 24, 28)

Pose = tuple[float, float, float]


class Box(NamedTuple):
    """A parcel with its start and goal [m, rad; table frame]; `at` is the start as the host says.

    `legs` are where it goes after its goal, without the host.
    """

    start: Pose
    goal: Pose
    length_m: float = 0.28
    width_m: float = 0.28
    speed_m_s: float = 0.1
    acceleration_m_s2: float = 0.44
    flags: int = 0
    at: Pose | None = None
    legs: tuple[Pose, ...] = ()

    @property
    def end(self) -> Pose:
        """Where it is to be in the end."""
        return self.legs[-1] if self.legs else self.goal


class Heard(NamedTuple):
    """An estimate on the bus: when, the number of the cell, and the fields of the wire."""

    time_s: float
    cell: int
    fields: Sequence[int]


@dataclass
class NeighbourHost:
    """Brings up the cells of a layout and gives the boxes their identities, from 1.

    `places` has the cells that are given another cell's place, by number. From `reset_s` on it
    resets the faults of all drives and switches them on again.
    """

    layout: Layout
    boxes: Sequence[Box]
    places: Mapping[int, int] = field(default_factory=dict)
    reset_s: float = math.inf
    wake_s: float = _BEGIN_S
    estimates: list[Heard] = field(default_factory=list)
    emergencies: list[tuple[float, int, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        buses = range(self.layout.bus_count)
        self._addresses = [*zip(self.layout.buses, self.layout.node_ids, strict=True)]
        self._numbers = {address: number for number, address in enumerate(self._addresses, 1)}
        self._writes = [[*self._settings(bus)] for bus in buses]
        self._answered = [True for _ in buses]
        self._next_sync_s = math.inf
        self._beats = 0
        self._reset_words = [cia402.FAULT_RESET, cia402.SHUTDOWN, cia402.SWITCH_ON]

    def _settings(self, bus: int) -> Iterator[Frame]:
        for number, (its_bus, node_id) in enumerate(self._addresses, 1):
            if its_bus != bus:
                continue
            place = self.places.get(number, number)
            for entry, value in all_values(self.layout, place).items():
                if value != ENTRIES[entry].default:
                    yield _write(node_id, *entry, value)
            # As the coordinator sets cells that steer.
            yield _write(node_id, indices.TPDO_PARAMETERS + 1, 5, _REPEAT_MS)
            yield _write(node_id, indices.CONSUMER_TIMES, 1, HOST_NODE << 16 | _CONSUMER_MS)
            yield _write(node_id, indices.LEASE, _TAKEOVER, 1)
            yield _write(node_id, indices.CONTROL, 0, 1)

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """Take in what cells send; raises ValueError for a setting that is refused."""
        node_id = frame.can_id & 0x7F
        base, number = frame.can_id - node_id, self._numbers.get((bus, node_id))
        if number is None:
            return
        if base == cob.SDO_RESPONSE_BASE:
            if frame.data[0] == 0x80:
                raise ValueError(f"cell {number} refuses a setting: {frame.data.hex()}")
            self._answered[bus] = True
        elif base == cob.TPDO_BASES[2]:
            fields = array("i", [0] * wire.ESTIMATE_FIELDS)
            wire.unpack_estimate(frame.data, fields)
            self.estimates.append(Heard(now_s, number, fields))
        elif base == cob.EMCY_BASE:
            self.emergencies.append((now_s, number, bytes(frame.data)))

    def poll_buses(self, now_s: float) -> Iterable[tuple[int, Frame]]:
        """What is due: settings one by one, then SYNC and what belongs to a beat."""
        self.wake_s = now_s + 0.001
        if any(self._writes):
            yield from self._next_writes()
        elif self._next_sync_s == math.inf:
            self._next_sync_s = now_s
            yield from self._to_all(Frame(cob.NMT, bytes((nmt.START, 0))))
        elif now_s >= self._next_sync_s - 1e-9:
            self._next_sync_s += BEAT_S
            self.wake_s = self._next_sync_s
            yield from self._beat()

    def _next_writes(self) -> Iterator[tuple[int, Frame]]:
        for bus, writes in enumerate(self._writes):
            if writes and self._answered[bus]:
                self._answered[bus] = False
                yield bus, writes.pop(0)

    def _beat(self) -> Iterator[tuple[int, Frame]]:
        self._beats += 1
        yield from self._to_all(Frame(cob.SYNC, b""))
        if self._beats % _HEARTBEAT_BEATS == 0:
            alive = Frame(cob.HEARTBEAT_BASE + HOST_NODE, bytes((nmt.OPERATIONAL,)))
            yield from self._to_all(alive)
        if self._beats in (10, 12):
            yield from self._control(cia402.SHUTDOWN if self._beats == 10 else cia402.SWITCH_ON)
        if self.wake_s > self.reset_s and self._reset_words:
            yield from self._control(self._reset_words.pop(0))
        if self._beats in _PAGES_BEATS:
            for identity, box in enumerate(self.boxes, 1):
                for page in pages(identity, box):
                    yield from self._to_all(page)

    def _control(self, word: int) -> Iterator[tuple[int, Frame]]:
        data = pdo.CONTROLWORD.encode((word, word))
        for bus, node_id in self._addresses:
            yield bus, Frame(cob.RPDO_BASES[1] + node_id, data)

    def _to_all(self, frame: Frame) -> Iterator[tuple[int, Frame]]:
        return ((bus, frame) for bus in range(self.layout.bus_count))

    def pose(self, heard: Heard) -> Pose:
        """Where the cell that sent an estimate believes the parcel to be [table frame]."""
        x_m, y_m = self.layout.cell_positions_m[heard.cell - 1]
        step_m = wire.STEP_UM * 1e-6
        return (
            x_m + heard.fields[wire.X] * step_m,
            y_m + heard.fields[wire.Y] * step_m,
            heard.fields[wire.YAW] * 2 * math.pi / wire.TURN,
        )


def pages(identity: int, box: Box, sequence: int = 1) -> Iterator[Frame]:
    """The pages of a parcel's program."""
    size = (round(box.length_m / 250e-6), round(box.width_m / 250e-6))
    how = (round(box.acceleration_m_s2 * 100), round(box.speed_m_s * 200), box.flags)
    yield _page((identity, wire.PARCEL, sequence, wire.RECTANGLE, *size, *how))
    yield _page((identity, wire.PLACE, sequence, *_steps(box.at or box.start), 0, 0, 0))
    for leg, pose in enumerate((box.goal, *box.legs)):
        yield _page((identity, wire.GOAL, sequence, *_steps(pose), leg, len(box.legs), 0))


def _steps(pose: Pose) -> tuple[int, int, int]:
    x_m, y_m, yaw_rad = pose
    yaw = round(math.remainder(yaw_rad, 2 * math.pi) / (2 * math.pi) * wire.TURN)
    return round(x_m / 250e-6), round(y_m / 250e-6), yaw


def _page(fields: Sequence[int]) -> Frame:
    data = bytearray(wire.LENGTH)
    wire.pack_program(array("i", fields), data)
    return Frame(cob.PROGRAM, bytes(data))


def _write(node_id: int, index: int, sub: int, value: int) -> Frame:
    size = ENTRIES[index, sub].type.size
    head = bytes((0x23 | 4 - size << 2, index & 0xFF, index >> 8, sub))
    return Frame(cob.SDO_REQUEST_BASE + node_id, head + (value & 0xFFFFFFFF).to_bytes(4, "little"))


def off(pose: Sequence[float], goal: Pose) -> tuple[float, float]:
    """How far a pose is from a goal [m, rad]; one turned by pi is the same."""
    turn_rad = math.remainder(pose[2] - goal[2], math.pi)
    return math.hypot(pose[0] - goal[0], pose[1] - goal[1]), abs(turn_rad)


def is_at(pose: Sequence[float], goal: Pose) -> bool:
    """Whether a pose is within 5 mm and 2 degrees of a goal."""
    off_m, off_rad = off(pose, goal)
    return off_m < 0.005 and off_rad < math.radians(2)


@dataclass
class Run:
    """A finished run: the traffic of the bus and the motion of the parcels."""

    host: NeighbourHost
    record: Record
    tipped: bool

    @property
    def touches(self) -> int:
        """How often two parcels have begun to touch."""
        return sum(event.kind == "touch" for event in self.record.events)

    def error(self, parcel: int = 0) -> tuple[float, float]:
        """How far a parcel lies from its goal in the end [m, rad]; one turned by pi is the same."""
        return off(self.record.pose[-1, parcel], self.host.boxes[parcel].end)

    def arrived(self, parcel: int = 0) -> bool:
        """Whether a parcel lies at its goal within 5 mm and 2 degrees."""
        return is_at(self.record.pose[-1, parcel], self.host.boxes[parcel].end) and not self.tipped

    def stands(self, parcel: int = 0) -> bool:
        """Whether a parcel has not moved in the last half second."""
        return bool(abs(self.record.twist[-50:, parcel]).max() < 5e-3)

    def last(self, parcel: int = 0) -> list[Heard]:
        """The last estimates of the cells under a parcel, as of the last beats."""
        late_s = self.host.estimates[-1].time_s - 5 * BEAT_S if self.host.estimates else 0.0
        newest = {each.cell: each for each in self.host.estimates if each.time_s > late_s}
        return [
            each
            for each in newest.values()
            if each.fields[wire.STATE] == wire.UNDER and each.fields[wire.IDENTITY] == parcel + 1
        ]

    def is_held(self, parcel: int = 0) -> bool:
        """Whether cells under a parcel have just reported that it lacks a promise.

        Two that are in each other's way may be given it in turns.
        """
        late_s = self.host.estimates[-1].time_s - _HELD_S if self.host.estimates else 0.0
        return any(
            each.time_s > late_s
            and each.fields[wire.IDENTITY] == parcel + 1
            and each.fields[wire.STATE] == wire.UNDER
            and each.fields[wire.HOLD] == 0
            for each in self.host.estimates
        )

    def is_cut_off(self, parcel: int = 0) -> bool:
        """Whether a cell that had a parcel at some time has reported the host's silence."""
        had = {
            each.cell for each in self.host.estimates if each.fields[wire.IDENTITY] == parcel + 1
        }
        return any(
            cell in had and int.from_bytes(data[:2], "little") == _HOST_LOST
            for _, cell, data in self.host.emergencies
        )

    def claims_arrival(self, parcel: int = 0) -> bool:
        """Whether more of the cells under a parcel report that it is at its goal than not."""
        arrived = [bool(each.fields[wire.FLAGS] & wire.ARRIVED) for each in self.last(parcel)]
        return sum(arrived) * 2 > len(arrived)

    @cached_property
    def suspected(self) -> dict[int, set[int]]:
        """The node ids that were suspected at any time, with the numbers of cells that did."""
        found: dict[int, set[int]] = {}
        for _, cell, data in self.host.emergencies:
            if int.from_bytes(data[:2], "little") == SUSPICION:
                found.setdefault(data[4], set()).add(cell)
        return found


def scenario_of(
    boxes: Sequence[Box],
    columns: int = 6,
    rows: int = 3,
    *,
    seed: int = 1,
    faults: Sequence[str] = (),
    overrides: Sequence[str] = (),
) -> Scenario:
    """A table with these parcels, on one bus for up to three rows of six, else on one for each
    block of three columns and up to six rows; faults are TOML tables.
    """
    several = []
    if columns * rows > 18:
        high = rows // -(-rows // 6)
        blocks = [
            [(y + up) * columns + x + along + 1 for up in range(high) for along in range(3)]
            for y in range(0, rows, high)
            for x in range(0, columns, 3)
        ]
        several = [f"array.buses={blocks}", "array.forwarded=[1, 2, 3, 4]"]
    return load_scenario(
        "array18",
        [
            f"array.columns={columns}",
            f"array.rows={rows}",
            f"parcel=[{', '.join(_parcel(number, box) for number, box in enumerate(boxes, 1))}]",
            f"fault=[{', '.join(faults)}]",
            f"run.seed={seed}",
            *several,
            *overrides,
        ],
    )


def _parcel(number: int, box: Box) -> str:
    x_m, y_m, yaw_rad = box.start
    goal_x_m, goal_y_m, goal_yaw_rad = box.goal
    return (
        f'{{name="box{number}", mass_kg=2.0, length_m={box.length_m}, width_m={box.width_m}, '
        f"x_m={x_m}, y_m={y_m}, yaw_rad={yaw_rad}, "
        f"goal={{x_m={goal_x_m}, y_m={goal_y_m}, yaw_rad={goal_yaw_rad}}}}}"
    )


def run(
    scenario: Scenario,
    boxes: Sequence[Box],
    until_s: float,
    places: Mapping[int, int] | None = None,
    still_after_s: float = math.inf,
    *,
    reset_s: float = math.inf,
) -> Run:
    """Run a scenario with cells that steer by themselves.

    It ends before `until_s` if nothing has moved for a while after `still_after_s`, which is
    shorter where all have arrived. All drives are reset from `reset_s` on.
    """
    host = NeighbourHost(layout_of(scenario), boxes, places or {}, reset_s)
    with closing(open_bank("cpython", addresses_of(scenario).node_ids)) as bank:
        simulation = Simulation(scenario, bank, [host])
        time_s = still_s = 0.0
        while time_s < until_s and still_s < _STILL_S and not simulation.tipped:
            time_s += _STEP_S
            simulation.run_until(min(time_s, until_s))
            poses, twists = simulation.world.motion
            still = abs(twists).max() < 1e-3 and time_s > still_after_s
            still_s = still_s + _STEP_S if still else 0.0
            if still_s >= _ARRIVED_S and all(map(is_at, poses, (box.end for box in boxes))):
                break
        return Run(host, simulation.outcome().record, simulation.tipped)
