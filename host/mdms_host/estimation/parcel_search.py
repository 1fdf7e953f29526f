"""Covered sensors that no parcel explains, and the search there for parcels that are not found.

The sensors are in groups, and a search begins wherever they have stood still.
"""

from collections.abc import Iterable, Iterator, Mapping
from math import hypot, inf

import numpy as np

from mdms_host.estimation.belief import BeliefChange, BeliefEvent, Standing
from mdms_host.estimation.pose.estimator import BESIDE_M, View
from mdms_host.estimation.presence import PresenceMap, SensorGroups, Surroundings
from mdms_host.estimation.roll_call import Found, RollCall, SensorScene
from mdms_host.estimation.tracked_parcel import TrackedParcel
from mdms_host.estimation.unknowns import Unknowns
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats, Ints

#: No parcel's.
NOBODY = -1


class Coverage:
    """All sensors (S,): the number of the parcel nearest to each, and how far its edge is [m].

    A covered sensor is `explained` where a found parcel is, or may be, and `taken` where it is for
    sure. `disputed` are sensors around a doubtful parcel. `number` is that of each parcel, by name.
    """

    def __init__(
        self, sensors: int, known: Mapping[str, TrackedParcel], views: Mapping[str, View]
    ) -> None:
        self.distance_m: Floats = np.full(sensors, np.inf)
        self.owner: Ints = np.full(sensors, NOBODY, dtype=np.int64)
        self.explained: Bools = np.zeros(sensors, dtype=bool)
        self.taken: Bools = np.zeros(sensors, dtype=bool)
        self.disputed: Bools = np.zeros(sensors, dtype=bool)
        self.number = {name: number for number, name in enumerate(known)}
        for number, (name, each) in enumerate(known.items()):
            if name in views:
                self._take(number, each, views[name])

    def _take(self, number: int, known: TrackedParcel, view: View) -> None:
        numbers, distance_m = view.near.sensors, view.distance_m
        nearer = distance_m < self.distance_m[numbers]
        mine = numbers[nearer]
        self.distance_m[mine] = distance_m[nearer]
        self.owner[mine] = number
        if known.standing is Standing.FOUND:
            unsure_m = known.estimator.unsure_m
            self.explained[numbers[distance_m < min(unsure_m, BESIDE_M)]] = True
            self.taken[numbers[distance_m < -unsure_m]] = True
        else:
            self.disputed[numbers[distance_m < BESIDE_M]] = True


#: Covered sensors must stay the same this long before parcels are searched for there [s].
_STILL_S = 0.05
#: Sensors behind a parcel that has left them are taken to show that parcel for so long [s], but no
#: longer once those that are covered have stayed the same for so long: what leaves goes on [s].
_WAKE_S = 1.0
_STANDS_S = 0.3
#: A sensor so far inside a parcel is under nothing else [m].
_INSIDE_M = 0.02
#: A group within one cell may be a broken cell.
_CELLS = 2


class UnexplainedSensors:
    """Sensors (S,) that are `foreign`: known to be under something else than the parcel beside it.

    `link_m` is how far neighbouring sensors are from each other.
    """

    def __init__(self, layout: Layout, surroundings: Surroundings) -> None:
        self._sensors_m = layout.sensors_m
        self._cell = layout.sensor_cells
        self._surroundings = surroundings
        self._grouping = SensorGroups(layout)
        self._wake_s: Floats = np.full(len(self._sensors_m), -inf)
        #: When parcels have left of late, and the sensors behind each.
        self._wakes: list[tuple[float, Ints]] = []
        #: When each sensor was under a parcel last, as was believed.
        self._under_s: Floats = np.full(len(self._sensors_m), -inf)
        self._last: tuple[bytes, tuple[Ints, ...]] = (b"", ())
        self.link_m = self._grouping.link_m
        self.foreign: Bools = np.zeros(len(self._sensors_m), dtype=bool)
        #: Covered ones (S,) that may show a parcel where it was when their cells reported, or that
        #: has just left.
        self._left_behind: Bools = np.zeros(len(self._sensors_m), dtype=bool)
        #: Those (S,) that a parcel alone explains, whatever they show.
        self._explained: Bools = np.zeros(len(self._sensors_m), dtype=bool)

    def leave(self, now_s: float, sensors: Ints) -> None:
        """A parcel over these sensors has left, or is about to fall off."""
        self._wake_s[sensors] = now_s + _WAKE_S
        self._wakes.append((now_s, sensors))

    def left_standing(self, now_s: float, covered: Bools, changed_s: Floats) -> Iterator[Ints]:
        """Covered sensors behind a parcel believed to have left, once none there changes any more.

        They show it no more: something lies there.
        """
        for wake in list(self._wakes):
            left_s, sensors = wake
            shown = sensors[covered[sensors]]
            if not len(shown) or now_s > left_s + _WAKE_S:
                self._wakes.remove(wake)
            elif now_s >= max(left_s, changed_s[sensors].max()) + _STANDS_S:
                self._wakes.remove(wake)
                self._wake_s[sensors] = -inf
                yield shown

    def just_left(self, now_s: float) -> Bools:
        """Sensors (S,) that a parcel has left so lately that they may show it still."""
        return self._wake_s >= now_s

    def groups(
        self, now_s: float, covered: Bools, valid: Bools, coverage: Coverage, silent_s: Floats
    ) -> tuple[Ints, ...]:
        """The groups of covered sensors that no found parcel explains.

        A parcel that has gone on explains what cells have reported before that, `silent_s` ago.
        """
        self._under_s[coverage.explained] = now_s
        explained = coverage.explained | (self._under_s >= now_s - silent_s)
        behind = (explained & ~coverage.explained) | self.just_left(now_s)
        self._left_behind = covered & valid & behind
        # Sensors that a parcel has moved over since then are its own.
        self.foreign &= covered & (coverage.distance_m > -_INSIDE_M)
        strange = covered & valid & (~explained | self.foreign) & ~self.just_left(now_s)
        self._explained = coverage.explained & ~strange
        key = strange.tobytes() + valid.tobytes()
        if key != self._last[0]:
            groups = tuple(self._grouping.of(strange, ~valid)) if strange.any() else ()
            self._last = key, groups
        return self._last[1]

    def beside(self, covered: Bools, coverage: Coverage) -> Bools:
        """Covered sensors (S,) outside all parcels that show something else, however near it is.

        They hang together, and most are farther beside every parcel than its own may be.
        """
        others: Bools = np.zeros(len(covered), dtype=bool)
        outside = covered & (coverage.distance_m > 0.0)
        if (outside & (coverage.distance_m > BESIDE_M)).any():
            for group in self._grouping.of(outside, others):
                far = coverage.distance_m[group] > BESIDE_M
                others[group] = 2 * far.sum() > len(group)
        return others

    def still(
        self, now_s: float, groups: Iterable[Ints], changed_s: Floats, *, at_once: bool
    ) -> tuple[Ints, ...]:
        """Those of the groups in and around which no sensor has changed of late.

        Those that a parcel explains, which may move, do not count `at_once`. Nor has a parcel just
        left any of these: whether such a sensor belongs to the group is known once its cell reports
        again, or once nothing leaves there any more.
        """
        changes = changed_s > now_s - _STILL_S
        if at_once:
            changes &= ~self._explained
        changes |= self._left_behind
        return tuple(group for group in groups if not changes[self._around(group)].any())

    def _around(self, group: Ints) -> Ints:
        low_m, high_m = self._sensors_m[group].min(axis=0), self._sensors_m[group].max(axis=0)
        reach_m = hypot(*(high_m - low_m).tolist()) / 2 + self.link_m
        return self._surroundings.of((low_m + high_m) / 2, reach_m).sensors

    def large(self, groups: Iterable[Ints]) -> Bools:
        """Sensors (S,) of groups that are under more than one cell's worth of something."""
        members: Bools = np.zeros(len(self._sensors_m), dtype=bool)
        for group in groups:
            if len(np.unique(self._cell[group])) >= _CELLS:
                members[group] = True
        return members


class ParcelSearch:
    """Finds parcels over covered sensors that nothing explains; one search a step.

    A search takes long. `settled` is whether everything has been tried. `faulty` are the cells
    (from 1) with sensors (from 0) without which parcels were found in the last step, `misfits` the
    things that were named as parcels, and turned out not to have their outlines.
    """

    def __init__(
        self,
        layout: Layout,
        surroundings: Surroundings,
        presence: PresenceMap,
        unexplained: UnexplainedSensors,
        unknowns: Unknowns,
    ) -> None:
        self._presence = presence
        self._unexplained = unexplained
        self._unknowns = unknowns
        self._roll_call = RollCall(layout, surroundings)
        self.faulty: list[tuple[int, list[int]]] = []
        self.misfits: list[BeliefChange] = []
        self.settled = True

    @property
    def heaps(self) -> set[bytes]:
        """Groups of covered sensors that are several parcels, as bytes."""
        return self._roll_call.heaps

    def step(
        self,
        now_s: float,
        valid: Bools,
        known: dict[str, TrackedParcel],
        groups: tuple[Ints, ...],
        taken: Bools,
    ) -> list[str]:
        """Search on for parcels that are not found; the names of those found now.

        The search begins once all cells have reported. None is found over sensors (S,) that are
        `taken` by found parcels.
        """
        self.faulty, self.misfits = [], []
        missing = [each for each in known.values() if each.standing is not Standing.FOUND]
        if not any(each.estimator.rests for each in missing) or not self._presence.complete:
            self.settled = not missing
            return []
        groups = self._whole(now_s, missing, groups)
        # One that has been lost may be set down before another. Newcomers come where nobody goes.
        lost = any(each.last is not None for each in missing)
        changed_s = self._presence.changed_s
        still = self._unexplained.still(now_s, groups, changed_s, at_once=lost)
        self.settled = not groups
        if still:
            still = self._parted(now_s, missing, still)
        if not still:
            return []
        sought = [each.sought for each in missing if each.estimator.rests]
        disputed = self._disputed(now_s, missing)
        scene = SensorScene(self._presence.covered, valid, still, taken, disputed)
        found = self._roll_call.step(sought, scene)
        for one in found:
            self._start(now_s, valid, known[one.name], one)
        if self._roll_call.settled:
            self.settled = True
            shown = np.zeros(len(valid), dtype=bool)
            for group in still:
                shown[group] = True
            for one in found:
                shown[one.group] = False
            self._settle(now_s, valid, known, shown)
        return [one.name for one in found]

    def _whole(
        self, now_s: float, missing: Iterable[TrackedParcel], groups: tuple[Ints, ...]
    ) -> tuple[Ints, ...]:
        """The groups, but those that lie where one doubtful parcel was are taken together.

        A cell that shows nothing may cut off a piece of it.
        """
        for each in missing:
            if len(groups) < 2:
                break
            inside = self._around(now_s, each, each.estimator.unsure_m)
            own = [group for group in groups if inside[group].any()]
            if len(own) > 1:
                rest = tuple(group for group in groups if not inside[group].any())
                groups = (np.sort(np.concatenate(own)), *rest)
        return groups

    def _parted(
        self, now_s: float, missing: Iterable[TrackedParcel], groups: tuple[Ints, ...]
    ) -> tuple[Ints, ...]:
        """The groups, but those around doubtful parcels that still move: nothing else is there.

        Each is looked for once it rests, and another that looks like it is not found in its place.
        """
        claimed = self._disputed(now_s, (each for each in missing if not each.estimator.rests))
        return tuple(group for group in groups if not claimed[group].any())

    def _disputed(self, now_s: float, missing: Iterable[TrackedParcel]) -> Bools:
        """Sensors (S,) around where doubtful parcels were shown last."""
        disputed = np.zeros(len(self._presence.covered), dtype=bool)
        for each in missing:
            disputed |= self._around(now_s, each, BESIDE_M)
        return disputed

    def _around(self, now_s: float, known: TrackedParcel, within_m: float) -> Bools:
        """Sensors (S,) under a parcel, or so near to it; none without a pose."""
        around = np.zeros(len(self._presence.covered), dtype=bool)
        view = known.estimator.view(now_s)
        if view is not None:
            around[view.near.sensors[view.distance_m < within_m]] = True
        return around

    def _start(self, now_s: float, valid: Bools, known: TrackedParcel, found: Found) -> None:
        """A parcel has been found: sensors that contradict are not believed for now."""
        estimator, covered = known.estimator, self._presence.covered
        location = found.location
        if known.learns:
            allowed = self._unknowns.rectangles(
                found.group, valid & ~covered, known.sought.yaw_hint_rad
            )
            location = known.of_any_size(location, *allowed)
        estimator.start(now_s, location)
        known.keep_place(now_s)
        mine = valid & ~covered
        mine[found.group] = True
        wrong = estimator.contradicting(covered, mine) | found.left_out
        known.disbelieved = wrong
        self.faulty += self._presence.disbelieve(wrong)
        inside = self._around(now_s, known, estimator.unsure_m)
        self._unexplained.foreign &= ~inside
        self._unknowns.explain(known.parcel.name, inside)

    def _settle(
        self, now_s: float, valid: Bools, known: dict[str, TrackedParcel], shown: Bools
    ) -> None:
        """A parcel that was found nowhere is where it was, or does not fit its given outline.

        `shown` are covered sensors (S,) that no found parcel explains.
        """
        for name in self._roll_call.absent:
            each = known[name]
            if each.standing is Standing.DOUBTFUL:
                self._stay(now_s, valid, each, shown)
            elif each.unknown is not None and each.unknown in self._unknowns.all:
                self.misfits.append(
                    self._unknowns.all[each.unknown].change(BeliefEvent.MISFIT, name)
                )
                del known[name]

    def _stay(self, now_s: float, valid: Bools, known: TrackedParcel, shown: Bools) -> None:
        """A parcel whose sensors are all covered is where it was: a thing beside it contradicts."""
        estimator = known.estimator
        view = estimator.view(now_s)
        if view is None:
            return
        sensors, distance_m = view.near.sensors, view.distance_m
        if estimator.covers(view, shown[sensors], valid[sensors]):
            beside = (distance_m > estimator.unsure_m) & (distance_m < BESIDE_M)
            self._unexplained.foreign[sensors[beside & shown[sensors]]] = True
            estimator.resume(now_s)
