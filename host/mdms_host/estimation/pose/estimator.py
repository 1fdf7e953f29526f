"""Where one parcel is and how it moves, from presence bits and wheel speeds alone.

Wheels that roll give the twist; a sensor that changes shows that the parcel's edge is over it.
"""

from collections import deque
from dataclasses import dataclass
from math import hypot, inf, log, pi, sqrt

import numpy as np

from mdms_host.estimation.belief import Confirmation, Standing
from mdms_host.estimation.footprint import Footprint, Rectangle, edge_of
from mdms_host.estimation.locating import Location
from mdms_host.estimation.pose.feeling import moves_to_feel
from mdms_host.estimation.pose.pose_cloud import PoseCloud
from mdms_host.estimation.pose.pose_filter import PoseFilter, Sliding
from mdms_host.estimation.presence import Near, Surroundings
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.scenario.scenario import DRAWN_M

#: How well an edge is known at the instant a sensor changes.
_EDGE_M = 0.0002
#: A frame comes so long after its edge, give or take as much; the parcel has moved on meanwhile.
_LATENCY_S = 0.002
#: The observers of the cells report a speed so late.
_OBSERVER_LAG_S = 0.002
#: A parcel rests that moves no faster, its corners' turning included [m/s].
_RESTING_M_S = 0.005
#: A sensor is judged from this far inside the outline on, or from so many standard deviations of
#: the distance.
_DEEP_M = 0.015
_DEEP_DEVIATIONS = 3.0
#: A sensor that is covered farther beside a parcel shows something else.
BESIDE_M = 0.06
#: Cells so far beyond a parcel are looked at, and so many times farther than it reaches.
_AROUND_M = 0.1
_AROUND = 1.35
#: Least error of an edge that is believed, however well a parcel's place is known [m].
_NEAR_M = 0.012
#: An edge that is farther off, in standard deviations, is none of this parcel's.
_GATE = 5.0
#: Nor is one at which a sensor becomes covered farther beside a parcel that rests [m], and farther
#: than so many standard deviations.
_AT_REST_M = 0.005
_AT_REST_DEVIATIONS = 2.0
#: How well an edge is known where it is asked whose it is [m].
_LIKELY_M = 0.001
#: A parcel is shown where more of the sensors deep under it are covered.
_COVERED_SHARE = 0.5
#: A report has got lost where sensors that an edge has passed show nothing of it, and so many times
#: as many have told of a change within this [s]; where the edge was when the cell reported last is
#: known give or take this [m].
_TOLD = 3
_TOLD_S = 0.2
_TOLD_M = 0.003
#: A pose is carried on without new speeds for so long [s].
_CARRIED_S = 0.1
#: Cells answer each SYNC, so a longer step was a time in which nothing was heard of them [s].
UNSEEN_S = 0.05
#: The motion in it is unsure along its way, and by this share of that any other way.
_ASIDE = 0.25
#: So many of the last steps are kept. A report is looked back at for 0.4 s, in steps of 10 ms.
_STEPS = 64
#: So many sensors of one cell show that it is broken.
_ALONE = 2
#: A larger outline is worked out again from this change on [m].
_GROWN_M = 5e-5
#: A box that has grown into itself turned a quarter is that: where its sides differ by so much [m],
#: and both are as the other was drawn, give or take such a part of it.
_UNLIKE_M = 0.004
_ALIKE = 0.25
_KEPT_S = 0.5


@dataclass(frozen=True, slots=True)
class View:
    """The sensors around a parcel, and their distances from its edge [m], negative inside, (N,)."""

    near: Near
    distance_m: Floats


@dataclass(frozen=True, slots=True)
class Under:
    """The wheels around a parcel, and which of them are under it, (V,), and how many."""

    near: Near
    under: Bools
    count: int


@dataclass(frozen=True, slots=True)
class Shown:
    """Bits of the sensors of a view, (N,): whether each is `covered`, and whether it is `mine`.

    They are as of `silent_s` ago, when the cell reported last, and have not changed for `same_s`.
    `old` are those that may have changed since, as a report has got lost, or may have. `cell` is
    that of each sensor.
    """

    cell: Ints
    covered: Bools
    mine: Bools
    silent_s: Floats
    same_s: Floats
    old: Bools


class ParcelEstimator:
    """Estimate of one parcel's pose and twist [table frame; SI].

    `pose` is (x, y, yaw), or None until the parcel has been found, and when it is lost.
    `covariance` is of shape (3, 3) and `twist` is (vx, vy, yaw rate). `corrected` is set by every
    sensor that is believed. `unseen` is whether no speeds came for a while before the last ones.
    `footprint` is as large as edges show it, and `spread_m` how exact its drawing is. A twist
    divided by `corner_m` has a corner's speed instead of the rate.
    """

    def __init__(
        self, surroundings: Surroundings, footprint: Footprint, spread_m: float = DRAWN_M
    ) -> None:
        self._surroundings = surroundings
        self._spread_m = spread_m
        self._at_s = 0.0
        self._rolled_s = -inf
        #: When the speeds of all wheels under it were known last.
        self._whole_s = -inf
        self.corner_m: Floats = np.array([1.0, 1.0, 1.0 / footprint.reach_m])
        self._drawn = footprint
        self._growth: Floats = np.zeros(2)
        # The growth of a while ago, and of one more before: an apparent growth while the parcel is
        # lifted off must not be kept.
        self._kept_growths = (self._growth, self._growth)
        self._kept_s = 0.0
        self._begun_rad = 0.0
        self._filter: PoseFilter | None = None
        # All poses that the sensors allow, as long as these are far apart.
        self._cloud: PoseCloud | None = None
        self._confirmation = Confirmation()
        self.footprint = footprint
        self.twist: Floats = np.zeros(3)
        self._sliding = Sliding(self.corner_m)
        self._pushed_s = -inf
        #: The last steps: the time of each, and how far wheels have carried the parcel by then.
        self._way: deque[tuple[float, Floats]] = deque(maxlen=_STEPS)
        self.corrected = False
        self.unseen = False
        #: Sensors of the last view (N,) whose cell alone contradicted by more than can be believed.
        self.alone: Bools = np.zeros(0, dtype=bool)
        #: What was found at the last pose: a parcel that rests has the same again and again.
        self._view: tuple[Footprint, list[float], View] | None = None
        self._under: tuple[Footprint, list[float], Under] | None = None
        #: Sensors that have not told of an edge that most others have told of, by their places.
        self._untold_m: set[tuple[float, ...]] = set()

    @property
    def standing(self) -> Standing:
        """The standing of the belief."""
        return self._confirmation.standing

    @property
    def pose(self) -> Floats | None:
        """The pose at the last speeds, shape (3,)."""
        return None if self._filter is None else self._filter.mean[:3]

    @property
    def covariance(self) -> Floats:
        """Of the pose, shape (3, 3); zero without one."""
        return np.zeros((3, 3)) if self._filter is None else self._filter.covariance[:3, :3]

    def start(self, now_s: float, found: Location) -> None:
        """Begin from a place, at rest."""
        reach_m = self._drawn.reach_m
        self._begun_rad = float(found.pose[2])
        self._filter = PoseFilter(
            found.pose, found.covariance, reach_m, self._growth, self._spread_m
        )
        self._cloud = None
        if len(found.poses):
            footprint = self.footprint if found.growths is None else self._drawn
            self._cloud = PoseCloud(
                footprint, found.poses, found.weights, found.grid, found.growths
            )
        self._confirmation.find(now_s)
        self.twist = np.zeros(3)
        self._at_s = now_s
        self._way.clear()
        self._way.append((now_s, np.zeros(3)))
        self._untold_m = set()
        self._corrected()
        if self._cloud is not None and found.growths is not None:
            self._settle(self._cloud)

    def blur(self, deviation_m: float) -> None:
        """The parcel may have moved by so much unseen, as a standard deviation."""
        if self._filter is not None:
            self._filter.blur(deviation_m)
            self._cloud = None

    def pose_at(self, now_s: float) -> Floats | None:
        """The pose carried on to a time near now by the present twist, for 0.1 s at most."""
        if self._filter is None:
            return None
        pose: Floats = self._filter.mean[:3] + self.twist * min(now_s - self._at_s, _CARRIED_S)
        return pose

    def resume(self, now_s: float) -> None:
        """The doubtful parcel is where it was after all: another thing contradicts it."""
        if self._filter is not None:
            self._confirmation.find(now_s)

    def near(self, pose: Floats) -> Near:
        """Sensors and wheels that may have to do with the parcel at a pose."""
        return self._surroundings.of(pose[:2], _AROUND * self.footprint.reach_m + _AROUND_M)

    def view(self, now_s: float) -> View | None:
        """The sensors around the parcel, and how far they are from it; None without a pose."""
        pose = self.pose_at(now_s)
        if pose is None:
            return None
        at, last = pose.tolist(), self._view
        if last is None or last[1] != at or last[0] is not self.footprint:
            near = self.near(pose)
            view = View(near, self.footprint.distance_m(near.sensors_m, pose))
            self._view = last = self.footprint, at, view
        return last[2]

    def wheels_under(self, pose: Floats) -> Under:
        """The wheels around the parcel at a pose, and which of them are under it."""
        at, last = pose.tolist(), self._under
        if last is None or last[1] != at or last[0] is not self.footprint:
            near = self.near(pose)
            under = self.footprint.distance_m(near.wheels_m, pose) < 0
            self._under = last = self.footprint, at, Under(near, under, int(under.sum()))
        return last[2]

    @property
    def rests(self) -> bool:
        """Whether the parcel hardly moves, as far as that is known."""
        return all(abs(speed) < _RESTING_M_S for speed in (self.twist / self.corner_m).tolist())

    @property
    def unsure_m(self) -> float:
        """Distance from the edge within which a sensor may show the parcel or not [m]."""
        return max(_NEAR_M, _DEEP_DEVIATIONS * self._deviation_m)

    @property
    def unsure_turn_m(self) -> float:
        """How far an edge may be elsewhere, as the parcel may be turned otherwise [m]."""
        if self._filter is None:
            return 0.0
        turn_rad2 = float(self._filter.covariance[2, 2])
        return _DEEP_DEVIATIONS * sqrt(turn_rad2) * self.footprint.reach_m

    def edge_misfit(self, now_s: float, point_m: Floats) -> float | None:
        """How badly an edge fits that is over a point now, in variances; None if it cannot be."""
        pose = self.pose_at(now_s - _LATENCY_S)
        if self._filter is None or pose is None or self.standing is not Standing.FOUND:
            return None
        away_m = hypot(*(point_m - pose[:2]).tolist())
        if away_m > self.footprint.reach_m + BESIDE_M:
            return None
        off_m, slope = edge_of(self.footprint, point_m, pose)
        variance_m2 = float(slope @ self._filter.covariance @ slope) + _LIKELY_M**2
        if off_m > BESIDE_M or off_m**2 > max(_GATE**2 * variance_m2, BESIDE_M**2):
            return None
        return off_m**2 / variance_m2 + log(variance_m2)

    def comes_up(self, now_s: float, point_m: Floats) -> bool:
        """Whether a sensor that has just been covered shows another thing: the parcel rests."""
        pose = self.pose_at(now_s)
        if self._filter is None or pose is None or self.twist.any():
            return False
        off_m, slope = edge_of(self.footprint, point_m, pose)
        deviation_m = sqrt(float(slope @ self._filter.covariance @ slope))
        return off_m > max(_AT_REST_M, _AT_REST_DEVIATIONS * deviation_m)

    @property
    def growth_deviation_m(self) -> tuple[float, float]:
        """Standard deviation of the outline on either side, along and across [m]."""
        if self._filter is None:
            return self._spread_m, self._spread_m
        along_m2, across_m2 = self._filter.covariance.diagonal()[3:].tolist()
        return sqrt(along_m2), sqrt(across_m2)

    def contradicting(self, covered: Bools, mine: Bools) -> Bools:
        """Sensors (S,) that contradict a place which has just been found by more than can be."""
        wrong = np.zeros(len(covered), dtype=bool)
        view = self.view(self._at_s)
        if view is not None:
            numbers, distance_m = view.near.sensors, view.distance_m
            shows = mine[numbers] & ((distance_m < 0) != covered[numbers])
            wrong[numbers] = shows & (abs(distance_m) > self._deep_m)
        return wrong

    def may_be(self, other: Footprint, covered: Bools, valid: Bools) -> bool:
        """Whether nothing that `valid` sensors (S,) show speaks against another outline here.

        A covered sensor beside the parcel may show a third one, so it does not count.
        """
        view, pose = self.view(self._at_s), self.pose_at(self._at_s)
        if view is None or pose is None:
            return False
        numbers = view.near.sensors
        distance_m = other.distance_m(view.near.sensors_m, pose)
        shows = valid[numbers] & (~covered[numbers] | (view.distance_m < 0))
        wrong = shows & ((distance_m < 0) != covered[numbers])
        return not (wrong & (abs(distance_m) > self._deep_m)).any()

    def moves_to_feel(self, usable: Bools) -> tuple[Floats, ...]:
        """Moves, (3,), that would make the place surer, best first; none where it is sure."""
        if self._filter is None:
            return ()
        pose, covariance = self._filter.mean[:3], self._filter.covariance
        near = self.near(pose)
        return moves_to_feel(self.footprint, near.sensors_m, usable[near.sensors], pose, covariance)

    def kept_twist(self, now_s: float, *, missing: bool) -> Floats:
        """The twist that stays as far as no wheel shows another: 0 unless speeds are `missing`.

        It stays for 0.1 s, as in `roll`.
        """
        if not missing:
            self._whole_s = now_s
        stays = missing and now_s <= self._whole_s + _CARRIED_S
        return self.twist if stays else np.zeros(3)

    def roll(self, now_s: float, twist: Floats | None) -> None:
        """Go on to a time at which this was the twist; None where no wheel shows it.

        Then it stays for 0.1 s: by then cells that nobody commands have braked, 50 ms after their
        last setpoint. So a parcel has gone on for as long in a time without speeds, give or take
        half of that.
        """
        if self._filter is None:
            return
        before = self.twist
        self._end_slip(now_s, twist)
        if twist is not None:
            self.twist, self._rolled_s = twist, now_s
        elif now_s > self._rolled_s + _CARRIED_S:
            self.twist = np.zeros(3)
        step_s = max(0.0, now_s - self._at_s)
        self.unseen = step_s > UNSEEN_S
        if self.unseen:
            self._sliding.begin_again()
            gone_on = (before - self.twist) * min(step_s, _CARRIED_S)
            moved, unsure = self.twist * step_s + gone_on, gone_on / 2
            self._filter.stretch(unsure)
            # Cells do not brake at the same instant, which turns a parcel or moves it aside.
            self._filter.blur(_ASIDE * float(np.linalg.norm(unsure / self.corner_m)))
        else:
            late = (self.twist - before) * _OBSERVER_LAG_S if twist is not None else 0.0
            moved = (before + self.twist) * (step_s / 2) + late
        self._filter.move(moved, step_s, self._sliding.variance_m2_s)
        if self._cloud is not None:
            self._cloud.move(moved)
        self._at_s = now_s
        self._way.append((now_s, self._way[-1][1] + moved))

    def slide(self, missing: Floats, gained: Floats, step_s: float) -> None:
        """In the last step the wheels gained so much [a second], so much more than they pushed to.

        Both are twists, shape (3,).
        """
        if self._filter is not None:
            self._sliding.step(missing, gained, step_s)
            self._pushed_s = self._at_s

    def _end_slip(self, now_s: float, twist: Floats | None) -> None:
        """Wheels that stand do not slip; nor do those of whose pushes nothing is reported."""
        stand = twist is not None and not twist.any()
        if stand or now_s > self._pushed_s + _CARRIED_S:
            self._sliding.begin_again()

    def edge(self, now_s: float, point_m: Floats, covered: bool) -> None:
        """A sensor there has just been covered, or not: the edge was over it when the cell saw it.

        Near a corner the nearest side may not be the one that crossed it: where the parcel moves
        the other way, it was not.
        """
        pose = self.pose_at(now_s - _LATENCY_S)
        if self._filter is None or pose is None or self.standing is not Standing.FOUND:
            return
        off_m, slope = edge_of(self.footprint, point_m, pose)
        rate_m_s = float(slope[:3] @ self.twist)
        if abs(rate_m_s) > _RESTING_M_S and covered != (rate_m_s < 0):
            return
        late_m = _LATENCY_S * rate_m_s
        if self._cloud is not None:
            self._cloud.on_edge(point_m, late_m)
            self._settle(self._cloud)
            return
        untold = tuple(point_m.tolist()) in self._untold_m
        if self._is_late(off_m, slope, rate_m_s, covered, untold=untold):
            return
        if self._filter.on_edge(off_m, slope, (_EDGE_M**2 + late_m**2) ** 0.5):
            self._corrected()

    def agree(self, now_s: float, view: View, seen: Shown) -> Standing:
        """Correct the estimate by every sensor that contradicts it, as far as possible.

        The view is that of now. Nothing corrects an estimate that is not `FOUND`, and a lost parcel
        has no pose any more.
        """
        covered, mine = seen.covered, seen.mine
        self.alone = np.zeros(len(mine), dtype=bool)
        shown = self._shown(covered, mine, view.distance_m)
        if shown and self.standing is Standing.FOUND:
            distance_m = view.distance_m
            mine = mine & ~self._unheard(view, seen)
            wrong = mine & ((distance_m < 0) != covered) & (distance_m < BESIDE_M)
            self.alone = self._broken(now_s, view, seen, wrong)
            wrong &= ~self.alone
            if self._cloud is not None:
                asked = wrong | mine & (abs(distance_m) < self._cloud.spread_m)
                shown &= self._cloud.on_bits(view.near.sensors_m, covered, asked)
                self._settle(self._cloud)
            else:
                for sensor in wrong.nonzero()[0].tolist():
                    shown &= self._bound(now_s, view.near.sensors_m[sensor])
        self._confirm(now_s, shown)
        return self.standing

    def covers(self, view: View, covered: Bools, mine: Bools) -> bool:
        """Whether all of its sensors deep inside are covered, (N,): it may be where it was."""
        deep = mine & (view.distance_m < -self._deep_m)
        return bool(deep.any() and covered[deep].all())

    @property
    def _deviation_m(self) -> float:
        if self._filter is None:
            return 0.0
        x_m2, y_m2, _, along_m2, across_m2 = self._filter.covariance.diagonal().tolist()
        return sqrt(max(x_m2, y_m2) + max(along_m2, across_m2))

    @property
    def _deep_m(self) -> float:
        """Distance inside the edge from which on a sensor says nothing about the edge [m]."""
        return max(_DEEP_M, _DEEP_DEVIATIONS * self._deviation_m)

    def _confirm(self, now_s: float, shown: bool) -> None:
        """Take in whether the parcel is shown where it is believed to be."""
        before = self.standing
        if self._confirmation.step(now_s, shown) is Standing.LOST:
            self._lose()
        elif self.standing is not before:
            self._grow(self._kept_growths[1])
        elif self.standing is Standing.FOUND and now_s >= self._kept_s + _KEPT_S:
            self._kept_growths, self._kept_s = (self._growth, self._kept_growths[0]), now_s

    def _lose(self) -> None:
        """Where the parcel is is not known any more."""
        self._filter = self._cloud = None
        self.twist = np.zeros(3)
        self._sliding.begin_again()

    def _shown(self, covered: Bools, mine: Bools, distance_m: Floats) -> bool:
        """Whether most of the sensors that lie deep under the parcel are covered."""
        if self._filter is None:
            return False
        deep = mine & (distance_m < -self._deep_m)
        if not deep.any():
            deep = mine & (distance_m < 0)
        return bool((deep & covered).sum() > _COVERED_SHARE * deep.sum())

    def _unheard(self, view: View, seen: Shown) -> Bools:
        """Sensors (N,) that contradict by silence, where a report that has got lost explains it.

        They agreed with where the parcel was when their cells reported last. That an edge has
        passed them since would be known but for a lost report. One may have got lost if frames do
        now, or if most other sensors have told of an edge. Where few have, the parcel does not move
        as its wheels do.
        """
        wrong: Bools = seen.mine & ((view.distance_m < 0) != seen.covered)
        self._untold_m = set()
        if not wrong.any():
            return wrong
        told = seen.mine & ~wrong & (seen.same_s < _TOLD_S)
        pose = self.pose_at(self._at_s)
        assert pose is not None
        # The parcel was as far back there as the sensor would now be ahead.
        silent_s = np.minimum(seen.silent_s[wrong], 2 * _TOLD_S)
        dx_m, dy_m, turned_rad = self._carried_since(silent_s).T
        x_m, y_m = (view.near.sensors_m[wrong] - pose[:2]).T
        then_m = np.column_stack((x_m + dx_m - turned_rad * y_m, y_m + dy_m + turned_rad * x_m))
        sign = np.where(seen.covered[wrong], 1.0, -1.0)
        off_m = sign * self.footprint.distance_m(pose[:2] + then_m, pose)
        passed_m = sign * view.distance_m[wrong]
        agreed = off_m < np.minimum(_TOLD_M, passed_m - off_m)
        # A report that is newer than the pose tells of an edge that is about to be there. One that
        # has hardly passed is told of in a moment.
        newer = agreed & (silent_s < 0.0)
        silent = agreed & ~newer & (passed_m > _TOLD_M)
        most = _TOLD * silent.sum() <= told.sum() + newer.sum()
        if most:
            self._untold_m = {*map(tuple, view.near.sensors_m[wrong][silent].tolist())}
        unheard: Bools = np.zeros(len(wrong), dtype=bool)
        unheard[wrong] = agreed & (most | seen.old[wrong])
        return unheard

    def _broken(self, now_s: float, view: View, seen: Shown, wrong: Bools) -> Bools:
        """Those of the wrong sensors (N,) that are of a broken cell: they would pull the estimate.

        Two sensors of the cell show more than can be believed, and no other cell does.
        """
        broken: Bools = np.zeros(len(wrong), dtype=bool)
        pose = self.pose_at(now_s)
        if wrong.sum() < _ALONE or pose is None or self._filter is None or self._cloud is not None:
            return broken
        far = [
            cell
            for cell, point_m in zip(seen.cell[wrong], view.near.sensors_m[wrong], strict=True)
            if not self._filter.admits(*edge_of(self.footprint, point_m, pose))
        ]
        if len(far) >= _ALONE and len({*far}) == 1:
            broken = wrong & (seen.cell == far[0])
        return broken

    def _carried_since(self, ago_s: Floats) -> Floats:
        """How far wheels have carried the parcel since so long ago (N,), by the last steps (N, 3).

        Of a time to come (less than 0), it is how far they will, with the other sign.
        """
        times_s, ways = map(np.array, zip(*self._way, strict=True))
        then = [np.interp(self._at_s - ago_s, times_s, way) for way in ways.T]
        carried: Floats = ways[-1] - np.column_stack(then)
        carried += np.minimum(ago_s, 0.0)[:, None] * self.twist
        return carried

    def _is_late(
        self, off_m: float, slope: Floats, rate_m_s: float, covered: bool, *, untold: bool
    ) -> bool:
        """Whether an edge has passed a sensor a while ago, as is believed, and is told of now.

        The report of it has got lost, and came with another one. That is likelier where most other
        sensors have told of the edge, and this one was the `untold` one.
        """
        assert self._filter is not None
        deviation_m = sqrt(float(slope @ self._filter.covariance @ slope))
        sure_m = _GATE * deviation_m
        if untold:
            sure_m = min(sure_m, max(_NEAR_M, _DEEP_DEVIATIONS * deviation_m))
        passed = covered == (off_m < 0.0)
        return passed and sure_m < abs(off_m) < _TOLD_S * abs(rate_m_s)

    def _bound(self, now_s: float, point_m: Floats) -> bool:
        """A sensor there is on the other side of the edge; False if that cannot be believed."""
        pose = self.pose_at(now_s)
        if self._filter is None or pose is None:
            return True
        off_m, slope = edge_of(self.footprint, point_m, pose)
        late_m = 2 * _LATENCY_S * float(slope[:3] @ self.twist)
        believed = self._filter.on_bound(off_m, slope, (_EDGE_M**2 + late_m**2) ** 0.5)
        if believed:
            self._corrected()
        return believed

    def _settle(self, cloud: PoseCloud) -> None:
        """Take the place over from the poses that the sensors allow."""
        assert self._filter is not None
        self._filter.place(cloud.mean, cloud.covariance)
        if cloud.small:
            self._cloud = None
        self._corrected()

    def _corrected(self) -> None:
        self.corrected = True
        assert self._filter is not None
        if self._cloud is None and self._is_turned(self._filter):
            self._turn(self._filter)
        growth = self._filter.mean[3:]
        if abs(growth - self._growth).max() > _GROWN_M:
            self._grow(growth.copy())

    def _is_turned(self, one: PoseFilter) -> bool:
        """Whether edges have shown a box as long as it is wide, and as wide as it is long."""
        if not isinstance(self._drawn, Rectangle):
            return False
        half_m = (self._drawn.length_m - self._drawn.width_m) / 2
        off_m = np.abs(one.mean[3:] - (-half_m, half_m))
        unsure_m = np.sqrt(one.covariance.diagonal()[3:])
        alike_m = _ALIKE * abs(half_m)
        return 2 * abs(half_m) >= _UNLIKE_M and bool((off_m + unsure_m <= alike_m).all())

    def _turn(self, one: PoseFilter) -> None:
        """It lay a quarter turn from where it was believed: its sides are each other's."""
        assert isinstance(self._drawn, Rectangle)
        half_m = (self._drawn.length_m - self._drawn.width_m) / 2
        along_m, across_m = one.mean[3:].tolist()
        other = [0, 1, 2, 4, 3]
        one.covariance = one.covariance[np.ix_(other, other)]
        turned_rad = self._drawn.nearest_yaw_rad(one.mean[2] + pi / 2, self._begun_rad)
        one.mean = np.array([*one.mean[:2], turned_rad, across_m - half_m, along_m + half_m])

    def _grow(self, growth: Floats) -> None:
        self._growth = growth
        self.footprint = self._drawn.grown(*growth.tolist())
