"""The rules about parcels: one parcel a cell, and parcels apart."""

from collections.abc import Iterator, Set
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import build_cells, cell_centres
from mdms_model.arrays import Floats
from mdms_model.outline import gap_m, outline_of, own_outline_m, placed_m
from mdms_model.run.record import Contact, Event
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours import frames as wire
from mdms_sim.physics.plane.control_step import Registers
from mdms_sim.referee.truth import FRESH_NS, NS_PER_S, HostReport, Note, Truth, Word

#: A promise counts for so long after the cell has sent it (docs/cells.md).
LEASE_NS = 80_000_000
#: A parcel that leaves a cell is noticed within this [s]; see 'What feeds the wheels' there.
NOTICED_S = 0.3
#: Wheels are looked at this often [s].
_WHEELS_S = 0.05
#: A wheel that turns at least so fast, and with its voltage, is driven [m/s].
_TURNING_M_S = 0.005
#: How long it takes until brakes are on: the heartbeat of a host counts for so long [s].
REACTION_S = 0.1
#: Wheels that slip when the power goes still drive a parcel on for a moment.
_COASTING = 1.1
#: Rounding of ways, and how far a parcel sinks into another [m].
_SLACK_M = 0.001
#: A parcel that a hand has pushed or set down rests below this [m/s]. Once wheels drive it, it is
#: the run's own after so long at most [s]; on wheels that coast it rolls for as long as it may.
_REST_M_S = 0.001
_HANDLED_S = 3.0
#: The effect of an event on parcels is over after this [s].
_KEPT_S = 10.0
#: Parcels that touch again within this are still touching [s].
_AGAIN_S = 1.0
_HANDS = ("push", "lift")
_POWER = ("supply", "bridge_fault", "off")


@dataclass(frozen=True, slots=True)
class _Snapshot:
    """Places of parcels at an event, their shortest ways to a stop, and whether they coast.

    A hand on one `parcel` excuses nothing of the others; None: the event is of all.
    """

    parcel: int | None
    time_s: float
    pose: Floats
    speed_m_s: Floats
    way_m: Floats
    coasts: bool


class Parcels:
    """Judges the places of parcels, and the parcels that cells drive for.

    `unavoidable` has the touches and falls that full braking could not have avoided.
    """

    def __init__(self, truth: Truth, note: Note, word: Word) -> None:
        scenario = truth.scenario
        self.unavoidable: list[Event] = []
        self._truth = truth
        self._world = truth.world
        self._note = note
        self._word = word
        self._names = {parcel.name: number for number, parcel in enumerate(scenario.parcel)}
        self._now_s = 0.0
        # Apart
        self._steered = scenario.motion.field in ("goal", "program")
        self._reach_m = np.array([outline_of(parcel).radius_m for parcel in scenario.parcel])
        self._braking_m_s2 = _braking_m_s2(scenario)
        self._seen = 0
        self._handled: dict[int, float] = {}
        self._driven: set[int] = set()
        self._touching: dict[frozenset[int], float] = {}
        self._snapshots: list[_Snapshot] = []
        self._keep(0.0)
        # One parcel a cell
        self._centres_m = cell_centres(scenario.array)
        corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        self._square_m = scenario.array.pitch_m * corners
        self._own_m = [own_outline_m(parcel) for parcel in scenario.parcel]
        self._promised: dict[int, tuple[int, int]] = {}
        self._wrong_s: dict[int, float] = {}

    def watched(self, bus: int) -> Set[int]:
        """The identifiers that it wants to see on a bus, from 0."""
        return self._word.watched(bus)

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """A watched frame has got through on a bus, and `word` has it."""
        cell = self._word.cells[bus].get(frame.can_id)
        if cell is None or cell not in self._word.estimates:
            return
        estimate = self._word.estimates[cell]
        if estimate.state < wire.PROMISED:
            return
        identity, time_ns = self._promised.get(cell, (estimate.identity, 0))
        if identity != estimate.identity and now_ns - time_ns < LEASE_NS:
            parcel = self._name_of(estimate.identity)
            late_ms = (now_ns - time_ns) / 1e6
            text = (
                f"cell {cell + 1} promises itself to {parcel} {late_ms:.0f} ms after "
                f"{self._name_of(identity)}"
            )
            self._note("one_parcel", text, cell=cell + 1, parcel=parcel)
        self._promised[cell] = estimate.identity, now_ns

    def _name_of(self, identity: int) -> str:
        number = self._word.parcels.get(identity)
        if number is None:
            return f"identity {identity}"
        return self._truth.scenario.parcel[number].name

    def on_fault(self, fault: Fault, begins: bool, now_ns: int) -> None:
        """A fault begins or ends."""
        now_s = now_ns / NS_PER_S
        if fault.kind in _HANDS:
            number = self._names[fault.parcel]
            self._handled[number] = now_s
            self._driven.discard(number)
            self._keep(now_s, number)
            return
        # Motors without a supply, and open bridges, do not brake.
        coasts = begins and fault.kind in _POWER and not fault.cells
        self._keep(now_s, coasts=coasts)

    def look(self, now_ns: int) -> None:
        """Check the parcels for touches, tips and falls."""
        self._now_s = now_ns / NS_PER_S
        events = self._world.events
        for event in events[self._seen :]:
            self._judge(event)
        self._seen = len(events)

    # Apart ---------------------------------------------------------------------------------------

    def _judge(self, event: Event) -> None:
        if event.kind == "arrival" and event.parcel is not None:
            self._keep(event.time_s, self._names[event.parcel])
        if event.kind not in ("touch", "tip") or not self._steered or event.parcel is None:
            return
        concerned = [self._names[event.parcel]]
        if event.kind == "touch":
            concerned.append(self._names[_touched(event)])
            pair = frozenset(concerned)
            last_s, self._touching[pair] = self._touching.get(pair, -inf), event.time_s
            if event.time_s - last_s < _AGAIN_S:
                return
        if self._is_unavoidable(event.time_s, concerned):
            self.unavoidable.append(event)
            # Its neighbour is pushed, too.
            self._handled.update(dict.fromkeys(concerned, event.time_s))
            self._driven.difference_update(concerned)
        else:
            self._note("apart", f"{event.parcel} {event.detail}", parcel=event.parcel)

    def _is_unavoidable(self, time_s: float, concerned: list[int]) -> bool:
        """Whether a hand has done it, or all were still within their braking ways since an event.

        A parcel that has gone no farther than that would have come there under full braking, too.
        """
        if any(number in self._handled for number in concerned):
            return True
        pose = self._world.pose[concerned]
        for event in self._snapshots:
            if event.parcel is not None and event.parcel not in concerned:
                continue
            turned_m = abs(pose - event.pose[concerned])[:, 2] * self._reach_m[concerned]
            gone_m = np.hypot(*(pose - event.pose[concerned])[:, :2].T) + turned_m
            way_m = event.way_m[concerned]
            if event.coasts:
                way_m = _COASTING * event.speed_m_s[concerned] * (time_s - event.time_s)
            if (gone_m <= way_m + _SLACK_M).all():
                return True
        return False

    def _keep(self, now_s: float, parcel: int | None = None, *, coasts: bool = False) -> None:
        """Keep how parcels move at an event of all, or of one parcel."""
        pose, twist = self._world.motion
        speed_m_s = np.hypot(*twist[:, :2].T) + abs(twist[:, 2]) * self._reach_m
        braking_m = 1.3 * speed_m_s**2 / (2.0 * self._braking_m_s2) if self._braking_m_s2 else inf
        way_m = speed_m_s * REACTION_S + braking_m
        self._snapshots = [
            *(each for each in self._snapshots if now_s - each.time_s < _KEPT_S),
            _Snapshot(parcel, now_s, pose, speed_m_s, way_m, coasts),
        ]

    def _let_go(self, voltage_uv: Registers) -> None:
        """Parcels that a hand has moved are the run's own again once they rest, or are driven."""
        touching = self._world.scene.state.wheels["contact"] != Contact.NONE
        carried = self._world.scene.scratch.wheels["parcel"]
        self._driven.update(carried[self._turning(voltage_uv) & touching].tolist())
        twist = self._world.twist
        speed_m_s = np.hypot(*twist[:, :2].T) + abs(twist[:, 2]) * self._reach_m
        lifted = self._world.scene.state.parcels["lifted"]
        for number, since_s in list(self._handled.items()):
            passed_s = self._now_s - since_s
            rests = passed_s > _WHEELS_S and speed_m_s[number] < _REST_M_S
            late = passed_s > _HANDLED_S and number in self._driven
            if not lifted[number] and (rests or late):
                del self._handled[number]

    # One parcel a cell ---------------------------------------------------------------------------

    def look_at_wheels(self, now_ns: int, voltage_uv: Registers, report: HostReport | None) -> None:
        """Note cells that have driven for another parcel than the one over them for some time.

        Voltages are those of all cells, by their places.
        """
        if self._handled:
            self._let_go(voltage_uv)
        left = self._unsteered(report)
        if not (left or self._word.parcels):
            return
        wrong = dict(self._wrong(now_ns, voltage_uv, left))
        self._wrong_s = {cell: self._wrong_s.get(cell, 0.0) + _WHEELS_S for cell in wrong}
        for cell, since_s in self._wrong_s.items():
            if NOTICED_S < since_s <= NOTICED_S + _WHEELS_S:
                number, text = wrong[cell]
                parcel = self._truth.scenario.parcel[number].name
                self._note("one_parcel", f"{text} {parcel}", cell=cell + 1, parcel=parcel)

    def _unsteered(self, report: HostReport | None) -> list[int]:
        """The parcels that a host which steers to goals does not steer."""
        if report is None or self._truth.scenario.motion.field != "goal":
            return []
        if report.goals.keys() - self._names.keys():
            # A person has given a parcel another name: nobody can tell which one is meant.
            return []
        names = self._names.items()
        return [number for name, number in names if name not in report.goals]

    def _wrong(
        self, now_ns: int, voltage_uv: Registers, left: list[int]
    ) -> Iterator[tuple[int, tuple[int, str]]]:
        """The cells (from 0) that drive for another parcel now, the parcel over each, and a text.

        Nobody steers the parcels in `left`.
        """
        state, carried = self._world.scene.state, self._world.scene.scratch.wheels["parcel"]
        wheels = self._world.wheels
        turning = self._turning(voltage_uv)
        if not turning.any():
            return
        touching = state.wheels["contact"] != Contact.NONE
        for number in left:
            if number not in self._handled:
                under = turning & touching & (carried == number)
                for cell in set(wheels.cell[under].tolist()):
                    yield cell, (number, f"cell {cell + 1} drives for another parcel under")
        driven = set(wheels.cell[turning].tolist())
        outlines_m = self._outlines_m()
        for node, estimate in self._word.estimates.items():
            place = int(self._truth.places[node])
            served = self._word.parcels.get(estimate.identity)
            late = now_ns - estimate.time_ns > FRESH_NS
            if place not in driven or late or estimate.state != wire.UNDER or served is None:
                continue
            square_m = self._centres_m[place] + self._square_m
            if served in outlines_m and gap_m(outlines_m[served], square_m) < 0.0:
                continue
            over = [n for n, each_m in outlines_m.items() if gap_m(each_m, square_m) < 0.0]
            if over and not self._handled.keys() & {*over, served}:
                name = self._truth.scenario.parcel[served].name
                yield node, (over[0], f"cell {node + 1} drives for {name} under")

    def _turning(self, voltage_uv: Registers) -> NDArray[np.bool_]:
        """Which wheels turn, and with their voltage, shape (W,)."""
        wheels = self._world.wheels
        axis = np.arange(len(wheels.cell)) - wheels.first[wheels.cell]
        speed_m_s = self._world.scene.state.wheels["speed_m_s"]
        pushed = voltage_uv[wheels.cell, axis] * np.sign(speed_m_s) > 0
        return np.asarray((abs(speed_m_s) > _TURNING_M_S) & pushed)

    def _outlines_m(self) -> dict[int, Floats]:
        """The outlines of the parcels on the table, by their numbers."""
        lifted = self._world.scene.state.parcels["lifted"].tolist()
        return {
            number: placed_m(self._own_m[number], pose)
            for number, pose in enumerate(self._world.pose)
            if not lifted[number]
        }


def _touched(event: Event) -> str:
    """The other parcel of a touch."""
    return event.detail.removeprefix("touches ").rsplit(" at x ", 1)[0]


def _braking_m_s2(scenario: Scenario) -> float:
    """Least deceleration by friction if the wheels along a way carry half of the weight."""
    friction = min(cell.friction for cell in build_cells(scenario))
    return friction * (1.0 - scenario.cell.friction_spread) * scenario.run.gravity_m_s2 / 2
