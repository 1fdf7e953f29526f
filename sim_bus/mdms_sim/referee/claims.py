"""The rules about reports: 'arrived' is true, and a fault is reported."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import degrees, hypot, inf, pi, radians, remainder

import numpy as np

from mdms_model.array import cell_centres
from mdms_model.arrays import Floats
from mdms_model.outline import outline_of, own_outline_m
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.scenario import Parcel, goal_of
from mdms_protocol.neighbours import frames as wire
from mdms_sim.referee.truth import FRESH_NS, NS_PER_S, HostReport, Note, Pose, Truth, Word

#: 'Arrived' means a truth within this, and is said where the host believes the parcel within that.
TRUE_M, TRUE_RAD = 0.005, radians(2.0)
BELIEVED_M, BELIEVED_RAD = 0.003, radians(1.0)
#: Most cells under a parcel say for so long that it has arrived: that is their word [s].
_CELLS_SAY_S = 0.5
_LOOK_S = 0.05
#: Parcels that stand are looked for in every so many looks.
_SLOW_LOOKS = 10
#: A stopped parcel is reported within this, and the reason of a run that cannot end within that
#: [s].
SAID_S = 2.0
WHY_S = 30.0
#: A reason may be given by so much before the parcel has come to rest [s].
_EARLY_S = 2.0
#: A parcel that has stood for so long since a fault and goes on is not stopped by it [s].
_PAUSE_S = 0.5
#: A parcel goes from this speed on, and has moved if it is so far from where it was.
_GOING_M_S = 0.005
_MOVED_M = 0.002
#: Corners of an outline that are this near to each other are the same [m].
_SAME_M = 0.001
#: Acts of a person on a parcel.
_BY_HAND = ("push", "lift")
#: Faults that are noticed at once, and stop their parcel.
_STOPPING = (
    *("off", "hang", "cut", "host", "supply", "bridge_fault"),
    *("sensor_stuck", "encoder_stuck", "wheel_jammed", "motor_reversed"),
)


Place = tuple[float, float, float]


@dataclass(slots=True)
class _Stopping:
    """A fault with the parcels that were moving then, and since when each stands [s]."""

    kind: str
    time_s: float
    going: set[int]
    stands_s: dict[int, float]


class Claims:
    """Judges the reports of the host and of the cells."""

    def __init__(self, truth: Truth, note: Note, word: Word) -> None:
        scenario = truth.scenario
        self._truth = truth
        self._world = truth.world
        self._note = note
        self._word = word
        self._parcels = scenario.parcel
        self._names = {parcel.name: number for number, parcel in enumerate(scenario.parcel)}
        self._symmetries = [_symmetry(parcel) for parcel in scenario.parcel]
        self._reach_m = np.array([outline_of(parcel).radius_m for parcel in scenario.parcel])
        self._looks = 0
        self._hosts_out = 0
        # True
        self._arrived: Mapping[str, Pose] = {}
        #: The goals at which parcels have arrived last.
        self._reached: dict[str, Pose] = {}
        #: Parcels that have been pushed or lifted since they arrived.
        self._handled: set[str] = set()
        self._over = False
        self._cells_say: dict[tuple[int, int], float] = {}
        # Said
        self._goals: Mapping[str, Pose] = _asked(scenario.parcel, truth)
        self._centres_m = cell_centres(scenario.array)
        self._stoppings: list[_Stopping] = []
        #: When a reason has been given last.
        self._said_s = -inf
        self._place_m: Floats = self._world.pose
        self._moved_s = np.zeros(len(scenario.parcel))
        self._mute = False

    def on_fault(self, fault: Fault, begins: bool, now_ns: int) -> None:
        """A fault begins or ends."""
        if begins and fault.kind in _STOPPING:
            # What a host that is killed now has said by now was said.
            self._said_s = max(self._said_s, self._said_by(self.report(), now_ns / NS_PER_S))
        if fault.kind == "host" and fault.bus is None:
            self._hosts_out += 1 if begins else -1
        if fault.kind in _BY_HAND and fault.parcel is not None:
            self._handled.add(fault.parcel)
        if begins and fault.kind in _STOPPING:
            going = {
                number
                for number in np.flatnonzero(self._speed_m_s() > _GOING_M_S).tolist()
                if self._concerns(fault, number)
            }
            self._stoppings.append(_Stopping(fault.kind, now_ns / NS_PER_S, going, {}))

    def report(self) -> HostReport | None:
        """The host's report of now; None if no host reports, or none any more."""
        return None if self._truth.host is None or self._hosts_out else self._truth.host()

    def look(self, now_ns: int, report: HostReport | None) -> None:
        """Check the reports of now."""
        if report is not None:
            self._check_arrivals(report)
            self._goals = report.goals
        elif self._word.parcels:
            self._hear_cells(now_ns)
        self._looks += 1
        slow = self._looks % _SLOW_LOOKS == 0
        if (slow or self._stoppings) and (report is not None or self._hosts_out):
            self._check_reasons(report, now_ns / NS_PER_S)

    def finish(self, now_ns: int) -> None:
        """The run is over."""
        self.look(now_ns, self.report())

    # True ----------------------------------------------------------------------------------------

    def _check_arrivals(self, report: HostReport) -> None:
        arrived = report.arrived
        if arrived != self._arrived:
            for name, goal in arrived.items():
                if self._arrived.get(name) != goal:
                    self._handled.discard(name)
                    self._reached[name] = goal
                    if name in report.guessed:
                        continue
                    self._check(name, goal, "has arrived, says the host,")
                    self._check_belief(name, goal, report.believed.get(name))
            self._arrived = dict(arrived)
        if report.over and not self._over:
            for name, goal in report.goals.items():
                by_hand = name in self._handled and self._reached.get(name) == goal
                if by_hand or name in report.guessed:
                    continue
                self._check(name, goal, "was asked for, and all is done, says the host, but it")
        self._over = report.over

    def _check(self, name: str, goal: Pose, claim: str) -> None:
        """Note a parcel that is not at its reported place."""
        number = self._names.get(name)
        if number is None:
            return
        off_m, off_rad = self._off(number, goal)
        if not (off_m <= TRUE_M and off_rad <= TRUE_RAD):
            text = f"{name} {claim} is {1e3 * off_m:.1f} mm and {degrees(off_rad):.1f} degrees off"
            self._note("true", text, parcel=name)

    def _check_belief(self, name: str, goal: Pose, believed: Place | None) -> None:
        """Note an arrival that is too far from the goal by the host's own belief."""
        number = self._names.get(name)
        if number is None or believed is None:
            return
        off_m, off_rad = self._off(number, goal, believed)
        if not (off_m <= BELIEVED_M and off_rad <= BELIEVED_RAD):
            self._note(
                "true",
                f"{name} has arrived, says the host, and believes it {1e3 * off_m:.1f} mm and "
                f"{degrees(off_rad):.1f} degrees off",
                parcel=name,
            )

    def _off(self, number: int, goal: Pose, place: Place | None = None) -> tuple[float, float]:
        """How far a parcel is from a goal, in truth or at a place, its symmetry allowed."""
        x_m, y_m, yaw_rad = self._world.pose[number].tolist() if place is None else place
        same_rad = self._symmetries[number]
        wanted_rad = goal[2]
        if wanted_rad is None or same_rad == 0.0:
            off_rad = 0.0
        else:
            off_rad = abs(remainder(yaw_rad - wanted_rad, same_rad))
        return hypot(x_m - goal[0], y_m - goal[1]), off_rad

    def _hear_cells(self, now_ns: int) -> None:
        """Check the report of the cells under each parcel, once it has lasted for a while."""
        said: dict[tuple[int, int], float] = {}
        for identity, number in self._word.parcels.items():
            voters = [each for each in self._word.under(identity, now_ns) if each.certainty]
            sequences = [each.sequence for each in voters if each.flags & wire.ARRIVED]
            if 2 * len(sequences) <= len(voters) or len(set(sequences)) != 1:
                continue
            claim = identity, sequences[0]
            goals = self._word.goals(*claim)
            before_s = self._cells_say.get(claim, -_LOOK_S)
            said[claim] = since_s = before_s + _LOOK_S
            if before_s < _CELLS_SAY_S <= since_s and goals:
                name = self._parcels[number].name
                nearest = min(goals, key=lambda goal: sum(self._off(number, goal)))
                self._check(name, nearest, "has arrived, say its cells,")
        self._cells_say = said

    # Said ----------------------------------------------------------------------------------------

    def _check_reasons(self, report: HostReport | None, now_s: float) -> None:
        pose = self._world.pose
        moved_m = np.hypot(*(pose - self._place_m)[:, :2].T)
        moved_m += abs(pose - self._place_m)[:, 2] * self._reach_m
        # A parcel that comes, or goes, has moved, too.
        moved = ~(moved_m < _MOVED_M)
        self._place_m[moved] = pose[moved]
        self._moved_s[moved] = now_s
        left = list(self._left())
        self._check_stoppings(report, now_s, left)
        since_s = max((self._moved_s[number] for number in left), default=now_s)
        mute = now_s - since_s >= WHY_S and self._said_by(report, now_s) < since_s - _EARLY_S
        if mute and not self._mute:
            name = self._parcels[left[0]].name
            text = (
                f"{name} is not at its goal, nothing has moved for {WHY_S:g} s, and nobody says why"
            )
            self._note("said", text, parcel=name)
        self._mute = mute

    def _left(self) -> Iterator[int]:
        """The parcels on the table that are not at their goals."""
        state = self._world.scene.state.parcels
        for name, goal in self._goals.items():
            number = self._names.get(name)
            if number is None or state["lifted"][number] or state["away"][number]:
                continue
            off_m, off_rad = self._off(number, goal)
            if off_m > TRUE_M or off_rad > TRUE_RAD:
                yield number

    def _check_stoppings(self, report: HostReport | None, now_s: float, left: list[int]) -> None:
        """Note a fault that has stopped a parcel, if nobody has reported it in time."""
        stands = self._speed_m_s() < _GOING_M_S
        self._said_s = max(self._said_s, self._said_by(report, now_s))
        for fault in self._stoppings:
            for number in fault.going & set(left):
                if not stands[number]:
                    if now_s - fault.stands_s.pop(number, now_s) > _PAUSE_S:
                        fault.going.discard(number)
                    continue
                since_s = fault.stands_s.setdefault(number, now_s)
                # A parcel that an earlier fault was stopping already has that one's reason.
                first_s = min(each.time_s for each in self._stoppings if number in each.stands_s)
                if now_s - since_s < SAID_S:
                    continue
                fault.going.discard(number)
                # A parcel that goes on after the fault, and stands later, may do so for a reason of
                # its own.
                caused = since_s - fault.time_s <= SAID_S
                if caused and self._said_s < first_s:
                    name = self._parcels[number].name
                    text = f"{name} stands since the fault '{fault.kind}', and nobody says so"
                    self._note("said", text, parcel=name)
        self._stoppings = [
            each for each in self._stoppings if each.going and now_s - each.time_s < 3 * SAID_S
        ]

    def _said_by(self, report: HostReport | None, now_s: float) -> float:
        """When the host, or the bus in its place, has given a reason last, as it shows now."""
        if report is not None:
            return report.trouble_s if report.reason is None else now_s
        # A cell that lacks a promise says so in its estimates.
        waits = any(
            each.state == wire.UNDER
            and each.hold == 0
            and now_s * NS_PER_S - each.time_ns <= FRESH_NS
            for each in self._word.estimates.values()
        )
        return now_s if waits else self._word.told_ns / NS_PER_S

    def _speed_m_s(self) -> Floats:
        twist = self._world.twist
        speed_m_s: Floats = np.hypot(*twist[:, :2].T) + abs(twist[:, 2]) * self._reach_m
        return speed_m_s

    def _concerns(self, fault: Fault, number: int) -> bool:
        """Whether a fault is of a cell at a parcel, or of all."""
        if not fault.cells:
            return True
        cells_m = self._centres_m[np.array(fault.cells) - 1]
        away_m = np.hypot(*(cells_m - self._world.pose[number, :2]).T)
        reach_m = self._reach_m[number] + self._truth.scenario.array.pitch_m / 2
        return bool((away_m <= reach_m).any())


def _asked(parcels: tuple[Parcel, ...], truth: Truth) -> dict[str, Pose]:
    """The goals that the scenario gives."""
    goals = ((parcel.name, goal_of(truth.scenario, parcel)) for parcel in parcels)
    return {name: (goal.x_m, goal.y_m, goal.yaw_rad) for name, goal in goals if goal is not None}


def _symmetry(parcel: Parcel) -> float:
    """The least turn after which a parcel looks the same [rad]; 0 for a disc: any."""
    if parcel.shape == "disc":
        return 0.0
    corners_m = own_outline_m(parcel)
    for folds in range(len(corners_m), 1, -1):
        turn_rad = 2 * pi / folds
        turn = np.array(
            [[np.cos(turn_rad), np.sin(turn_rad)], [-np.sin(turn_rad), np.cos(turn_rad)]]
        )
        away_m = np.hypot(*(corners_m @ turn - corners_m[:, None]).transpose(2, 0, 1))
        if (away_m.min(axis=1) < _SAME_M).all():
            return turn_rad
    return 2 * pi
