"""The knowledge of the referee: scenario, world, the host's reports, and the cells' word.

Reports of cells are taken from frames alone. A parcel's identity is known by its place, which a
program begins with.
"""

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field
from math import inf, pi
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mdms_model.buses import Addresses
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.messages import Goal, Parcel, Place, decode_page
from mdms_sim.physics.plane.world import World

#: Where a parcel is to be [m, m, rad; table frame]; the yaw is None where any will do.
Pose = tuple[float, float, float | None]


class Note(Protocol):
    """Notes a violation of a rule, by a cell (number from 1) or about a parcel."""

    def __call__(
        self, rule: str, text: str, *, cell: int | None = None, parcel: str | None = None
    ) -> None:
        """The violation is of this instant."""


@dataclass(frozen=True, slots=True)
class HostReport:
    """The host's report at one instant.

    `goals` has the parcels that it steers to one, `arrived` those that it reports there, and
    `believed` their believed poses. `reason` says why it cannot go on, if it does. `trouble_s` is
    the time of its last report of trouble [s]. `over` is whether its job has ended as requested.
    `guessed` has the parcels that may be in each other's places, as a person was told: nothing is
    claimed of them.
    """

    goals: Mapping[str, Pose] = field(default_factory=dict)
    arrived: Mapping[str, Pose] = field(default_factory=dict)
    believed: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    reason: str | None = None
    trouble_s: float = -inf
    over: bool = False
    guessed: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Truth:
    """The run as it is, for the judges.

    `places` has the place of each cell's node, both from 0. `host` returns the host's report of
    now, or None while no host runs. Without `host` reports are not known.
    """

    scenario: Scenario
    addresses: Addresses
    world: World
    places: NDArray[np.intp]
    host: Callable[[], HostReport | None] | None = None


NS_PER_S = 1_000_000_000
#: An estimate comes with every SYNC; an older one counts for nothing.
FRESH_NS = 50_000_000

# Where the fields of an estimate begin in its frame, which is one little-endian number.
_IDENTITY_BIT = 36
_STATE_BIT = 42
_CERTAINTY_BIT = 52
_HOLD_BIT = 56
_SEQUENCE_BIT = 59
_FLAGS_BIT = 61


class HeardEstimate(NamedTuple):
    """A cell's report of its parcel; codes as in `mdms_protocol.neighbours.frames`."""

    time_ns: int
    identity: int
    state: int
    certainty: int
    hold: int
    sequence: int
    flags: int


#: NMT commands that switch all drives off.
_STOPS_OF_ALL = frozenset(
    bytes((command, nmt.ALL_NODES)) for command in (nmt.STOP, nmt.ENTER_PRE_OPERATIONAL)
)


class Word:
    """The last estimate of each cell, and the parcels of the identities in programs.

    `cells` has the cell (from 0) of each identifier of an estimate, by bus; `estimates` the last
    one of each, by cell. `parcels` has the number of the parcel (from 0) that an identity is of.
    `told_ns` is when a cell has last sent an emergency, or all have been told to stop.
    """

    def __init__(self, truth: Truth) -> None:
        addresses = truth.addresses
        self.cells: list[dict[int, int]] = [{} for _ in range(addresses.bus_count)]
        self._emergencies: list[Set[int]] = []
        for bus, cells in enumerate(self.cells):
            nodes = [addresses.node_ids[number - 1] for number in addresses.on_bus(bus)]
            for number, node_id in zip(addresses.on_bus(bus), nodes, strict=True):
                cells[cob.ESTIMATE_BASE + node_id] = number - 1
            self._emergencies.append({cob.EMCY_BASE + node_id for node_id in nodes})
        self.estimates: dict[int, HeardEstimate] = {}
        self.parcels: dict[int, int] = {}
        self.told_ns = -NS_PER_S
        self._world = truth.world
        #: By identity, then by the sequence number of a program: where it takes the parcel.
        self._goals: dict[int, dict[int, list[Pose]]] = {}
        self._any_yaw: set[tuple[int, int]] = set()

    def watched(self, bus: int) -> Set[int]:
        """The identifiers that it wants to see on a bus, from 0."""
        return {cob.NMT, cob.PROGRAM, *self.cells[bus], *self._emergencies[bus]}

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """A watched frame has got through on a bus."""
        cell = self.cells[bus].get(frame.can_id)
        if cell is not None:
            if len(frame.data) == wire.LENGTH:
                self.estimates[cell] = _estimate_of(frame.data, now_ns)
        elif frame.can_id == cob.PROGRAM:
            self._take_page(frame.data)
        elif frame.can_id in self._emergencies[bus]:
            if any(frame.data[:2]):
                self.told_ns = now_ns
        elif frame.data in _STOPS_OF_ALL:
            self.told_ns = now_ns

    def under(self, identity: int, now_ns: int) -> list[HeardEstimate]:
        """The reports of the cells under the parcel of this identity."""
        return [
            each
            for each in self.estimates.values()
            if each.identity == identity
            and each.state == wire.UNDER
            and now_ns - each.time_ns <= FRESH_NS
        ]

    def goals(self, identity: int, sequence: int) -> list[Pose]:
        """The goals of a program: its goal, or for a way any place on it that may be meant."""
        goals = self._goals.get(identity, {}).get(sequence, [])
        if (identity, sequence) in self._any_yaw:
            return [(x_m, y_m, None) for x_m, y_m, _ in goals]
        return goals

    def _take_page(self, data: bytes) -> None:
        page = decode_page(data)
        if isinstance(page, Place):
            x_m, y_m, _ = _pose_of(page)
            away_m = np.hypot(*(self._world.pose[:, :2] - (x_m, y_m)).T)
            if not np.isnan(away_m).all():
                self.parcels[page.identity] = int(np.nanargmin(away_m))
        elif isinstance(page, Goal):
            self._take_goal(page)
        elif isinstance(page, Parcel):
            program = page.identity, page.sequence
            self._any_yaw.discard(program)
            if page.flags & wire.ANY_YAW:
                self._any_yaw.add(program)

    def _take_goal(self, page: Goal) -> None:
        """Keep the goals of this program, and of the one before, on which some cells still are."""
        goals = self._goals.setdefault(page.identity, {})
        follows = 0 < page.leg < wire.JOINS
        sequence = (page.sequence - 1 + page.leg * follows) % wire.SEQUENCE_MAX + 1
        places = goals.setdefault(sequence, [])
        pose = _pose_of(page)
        if pose in places:
            return
        if page.leg == 0:
            del goals[sequence]
            before = (sequence - 2) % wire.SEQUENCE_MAX + 1
            self._goals[page.identity] = {
                sequence: [pose],
                **{number: kept for number, kept in goals.items() if number == before},
            }
        else:
            places.append(pose)


def _estimate_of(data: bytes, now_ns: int) -> HeardEstimate:
    number = int.from_bytes(data, "little")
    return HeardEstimate(
        now_ns,
        number >> _IDENTITY_BIT & wire.IDENTITY_MAX,
        number >> _STATE_BIT & wire.UNDER,
        number >> _CERTAINTY_BIT & 15,
        number >> _HOLD_BIT & 7,
        number >> _SEQUENCE_BIT & wire.SEQUENCE_MAX,
        number >> _FLAGS_BIT,
    )


def _pose_of(page: Place | Goal) -> tuple[float, float, float]:
    step_m = wire.STEP_UM * 1e-6
    return page.x * step_m, page.y * step_m, page.yaw * 2 * pi / wire.TURN
