"""Which sensors belong to which parcel, and the estimates of all parcels."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from math import inf

import numpy as np

from mdms_host.estimation.belief import Belief, BeliefChange, BeliefEvent, Gain, Standing
from mdms_host.estimation.parcel import BoundingBox, ExitLine, Parcel
from mdms_host.estimation.parcel_search import Coverage, ParcelSearch, UnexplainedSensors
from mdms_host.estimation.pose.estimator import BESIDE_M, UNSEEN_S, Shown, View
from mdms_host.estimation.pose.rolling import Speeds, roll_on
from mdms_host.estimation.presence import PresenceMap, Surroundings
from mdms_host.estimation.size import Size
from mdms_host.estimation.tracked_parcel import TrackedParcel
from mdms_host.estimation.unknowns import Unknown, Unknowns
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.scenario.scenario import name_fault

__all__ = ["BoundingBox", "Estimate", "ExitLine", "Parcel", "Tracker"]

#: No parcel is so many times as large as the outline of the unknown thing that it is.
_FAR_LARGER = 2.0
#: A parcel that sets out goes less than half as far until an unknown thing counts, braking
#: included. The rest is how far a thing may reach beyond its sensors [m].
_AT_ONCE_M = 0.12


@dataclass(frozen=True, slots=True)
class Estimate:
    """Believed pose of a parcel [m, m, rad; table frame]."""

    x_m: float
    y_m: float
    yaw_rad: float


class Tracker:
    """Estimates of all parcels on the array, fed with presence bits and wheel speeds.

    Bits that a cell has not repeated for three of its periods count no more. `debounce_s` is how
    long each cell waits before it reports a change (none: not at all).
    """

    def __init__(
        self,
        layout: Layout,
        parcels: tuple[Parcel, ...] = (),
        status_period_s: float = inf,
        debounce_s: tuple[float, ...] = (),
    ) -> None:
        self._layout = layout
        self._sensors_m = layout.sensors_m
        self._surroundings = Surroundings(layout)
        self._presence = PresenceMap(
            layout.cells, len(layout.sensor_offsets_m), status_period_s, debounce_s
        )
        self._unexplained = UnexplainedSensors(layout, self._surroundings)
        self._unknowns = Unknowns(layout, self._surroundings, self._unexplained.link_m)
        self._parcel_search = ParcelSearch(
            layout, self._surroundings, self._presence, self._unexplained, self._unknowns
        )
        self._known = {parcel.name: TrackedParcel(parcel, self._surroundings) for parcel in parcels}
        #: Sensors (S,) of a cell that alone contradicts a parcel by more than can be believed.
        self._alone: Bools = np.zeros(len(self._sensors_m), dtype=bool)
        self._watching = True
        self._now_s = 0.0
        self._speeds_s = inf
        #: When every cell had reported for the first time, and parcels that lay there by then.
        self._complete_s = inf
        self._lay_there: set[str] = set()
        self._faulty: list[tuple[int, list[int]]] = []
        self._changes: list[BeliefChange] = []
        self._withdrawn: list[tuple[Parcel, BoundingBox | None]] = []

    # Parcels come and go

    def announce(self, parcel: Parcel, region: BoundingBox | None = None) -> None:
        """Expect a parcel: it is found once sensors show it, in `region` only if there is one.

        Those that look the same are found in the order in which they were announced. Raises
        ValueError for a name that is taken, or that no parcel can have, or a size that none has.
        """
        self._add(TrackedParcel(parcel, self._surroundings, region=region))

    def depart(self, name: str, gate: ExitLine | None = None) -> None:
        """Have a parcel leave through `gate`; without one it is gone already.

        Once it is through it is no parcel of this tracker any more. Raises KeyError for a name that
        there is not.
        """
        if gate is None:
            self._leave(name)
        else:
            self._known[name].gate = gate

    def stay(self, name: str) -> None:
        """Have a parcel not leave any more, whatever gate it was to leave through.

        Raises KeyError for a name that there is not.
        """
        self._known[name].gate = None

    @property
    def guessed(self) -> frozenset[str]:
        """Parcels that may be in each other's places, as a person was told."""
        return frozenset(name for name, each in self._known.items() if each.guessed)

    def take_withdrawn(self) -> list[tuple[Parcel, BoundingBox | None]]:
        """Parcels that have not come after all, with the regions where they were announced.

        Something else was taken for each. They are no parcels of this tracker any more, and may be
        announced again.
        """
        withdrawn, self._withdrawn = self._withdrawn, []
        return withdrawn

    def name(self, unknown: str, parcel: Parcel) -> None:
        """Take an unknown thing for a parcel, which is then found there, if it has that outline.

        Raises KeyError if there is nothing of that name. Raises ValueError for a name that is taken
        or that no parcel can have, and for a thing that is just being named. It also refuses a
        parcel that is far larger than the thing: the search for it would stop the cycle.
        """
        corners_m = self._unknowns.all[unknown].corners_m
        for each in self._known.values():
            if each.unknown == unknown:
                raise ValueError(
                    f"{unknown} is just being compared with {each.parcel.name!r:.60}; ask again"
                )
        _refuse_far_larger(unknown, corners_m, parcel)
        low_m, high_m = corners_m.min(axis=0).tolist(), corners_m.max(axis=0).tolist()
        region = BoundingBox((low_m[0], low_m[1]), (high_m[0], high_m[1]))
        self._add(TrackedParcel(parcel, self._surroundings, region=region, unknown=unknown))

    def size(self, name: str) -> Size | None:
        """Size of a rectangular parcel as far as sensors show, or of an unknown thing at rest.

        None for another shape. If a parcel was given this size when it was named, edges show it
        better as it moves. Raises KeyError for an unknown name.
        """
        if name in self._known:
            return self._known[name].size
        return self._unknowns.size(
            name, self._presence.valid(self._now_s) & ~self._presence.covered
        )

    def _add(self, known: TrackedParcel) -> None:
        name = known.parcel.name
        if fault := name_fault(name):
            raise ValueError(f"the name {name!r:.60} {fault}")
        _refuse_far_larger_than_table(known.parcel, self._layout)
        if name in self._known or name in self._unknowns.all:
            raise ValueError(f"there is a parcel {name!r} already; give each a name of its own")
        self._known[name] = known

    # Inputs

    def on_presence(self, now_s: float, cell: int, bits: int) -> None:
        """Cell `cell` (from 1) reports which of its sensors are covered: bit k sensor k."""
        self._note_deafness(now_s)
        for time_s, sensor in self._presence.on_report(now_s, cell, bits):
            if self._watching:
                self._on_edge(time_s, sensor)
        self._note_complete(now_s)

    def look_away(self) -> None:
        """Cells come and go, and parcels are at rest: what sensors show by then moves no belief."""
        self._watching = False

    def look_again(self, deviation_m: float) -> None:
        """Sensors count again; parcels may have moved by so much unseen, as a deviation."""
        if not self._watching:
            for known in self._known.values():
                known.look_again(deviation_m)
        self._watching = True

    def ignore_cells(self, cells: Collection[int]) -> None:
        """The sensors of these cells (from 1) show nothing from now on, those of all others do."""
        self._presence.ignore(cells)
        self._note_complete(self._now_s)

    def on_speeds(
        self,
        now_s: float,
        speed_m_s: Floats,
        known: Bools | None = None,
        standing: Bools | None = None,
    ) -> list[str]:
        """Wheels, shape (W,), had these speeds at that time; returns parcels found by that.

        The speeds of all wheels are `known` if that is None. `standing` are wheels that are to
        stand, and do but for the noise of their encoders.
        """
        self._note_deafness(now_s)
        self._now_s = self._speeds_s = now_s
        estimators = (each.estimator for each in self._known.values())
        roll_on(estimators, now_s, Speeds(speed_m_s, known, standing))
        if not self._watching:
            return []
        covered, changed_s = self._presence.covered, self._presence.changed_s
        for standing_there in self._unexplained.left_standing(now_s, covered, changed_s):
            self._unknowns.expect(standing_there)
        valid = self._presence.valid(now_s)
        views, coverage, groups = self._look(now_s, valid)
        sought = [name for name, each in self._known.items() if each.elsewhere is None]
        found = self._parcel_search.step(now_s, valid, self._known, groups, coverage.taken)
        self._faulty += self._parcel_search.faulty
        for name in found:
            self._note_coming(now_s, name)
        self._note_guesses(valid, [name for name in found if name in sought])
        if found:
            # Sensors that contradict them are not believed any more.
            valid = self._presence.valid(now_s)
            views, coverage, groups = self._look(now_s, valid)
            self._expect_obstacles(groups, coverage)
        self._agree(now_s, valid, views, coverage)
        self._watch_unknown(now_s, valid, coverage, groups)
        self._judge(now_s, views, coverage, groups)
        self._leave_obstacles(views)
        for name, each in list(self._known.items()):
            if each.gate is not None and each.has_left(
                self._is_anything_at(each, views.get(name), coverage)
            ):
                self._leave(name)
            elif each.was_none(now_s) or self._is_misjudged(now_s, name, views, coverage):
                self._withdraw(name)
        self._changes += self._parcel_search.misfits
        return found

    def on_loss(self, now_s: float) -> None:
        """A frame of a cell has got lost: others, with what sensors show, may have as well."""
        self._presence.on_loss(now_s)

    def on_pushes(self, gains: Mapping[str, Gain], step_s: float) -> None:
        """Take in the gains of the wheels under parcels in the last step, and their pushes."""
        for name, gain in gains.items():
            if name in self._known:
                self._known[name].estimator.slide(gain.missing, gain.gained, step_s)

    # Outputs

    def take_faulty(self) -> list[tuple[int, list[int]]]:
        """Cells (from 1) with sensors (from 0) that contradict all others, since the last call."""
        faulty, self._faulty = self._faulty, []
        return faulty

    def take_changes(self) -> list[BeliefChange]:
        """Changes of parcels and of unknown things since the last call."""
        standings = (each.take_change() for each in self._known.values())
        changes = [*self._changes, *(each for each in standings if each)]
        self._changes = []
        return changes + self._unknowns.take_changes()

    def beliefs(self, at_s: float, now_s: float, near: Collection[str] = ()) -> dict[str, Belief]:
        """Beliefs at a time near now, by name, of parcels and of unknown things.

        `near` are parcels about to arrive: their beliefs have the turn that would make them better
        known.
        """
        believed = {}
        for name, each in self._known.items():
            belief = each.belief(at_s, self._presence.valid(now_s) if name in near else None)
            if belief is not None:
                believed[name] = replace(belief, noisy=True) if self.noisy else belief
        return believed | {belief.name: belief for belief in self._unknowns.beliefs()}

    @property
    def noisy(self) -> bool:
        """Whether sensors are wrong too often to show where parcels are."""
        return self._presence.noisy

    @property
    def is_clear(self) -> bool | None:
        """Whether no sensor is covered; None before every cell has reported."""
        return None if self._complete_s == inf else not self._presence.covered.any()

    def lay_there(self, name: str) -> bool:
        """Whether a parcel lay where it was found before every cell had reported."""
        return name in self._lay_there

    @property
    def parcels(self) -> Mapping[str, Parcel]:
        """The parcels that there are, found or not, as they were given, by name."""
        return {name: each.parcel for name, each in self._known.items()}

    @property
    def unknown(self) -> Mapping[str, Unknown]:
        """The unknown things that are there, by name."""
        return self._unknowns.all

    def estimate(self, name: str, now_s: float) -> Estimate | None:
        """Where the parcel is believed to be; None as long as it has not been found."""
        pose = self._known[name].estimator.pose_at(now_s) if name in self._known else None
        return None if pose is None else Estimate(*pose.tolist())

    def poses(self, now_s: float) -> Mapping[str, Floats]:
        """Pose [m, m, rad; table frame] of every parcel that has been found."""
        found = ((name, each.estimator.pose_at(now_s)) for name, each in self._known.items())
        return {name: pose for name, pose in found if pose is not None}

    def covariance(self, name: str) -> Floats:
        """Covariance of a pose [m, m, rad], shape (3, 3); zero where the parcel is not found."""
        return self._known[name].estimator.covariance

    @property
    def doubtful(self) -> set[str]:
        """Parcels that sensors do not show where they are believed to be."""
        return {n for n, each in self._known.items() if each.standing is Standing.DOUBTFUL}

    # The cycle

    def _on_edge(self, now_s: float, sensor: int) -> None:
        """The edge that is likeliest to have crossed a sensor has; none, where none may have."""
        if self._unexplained.foreign[sensor]:
            return
        point_m = self._sensors_m[sensor]
        near = [
            (misfit, each)
            for each in self._known.values()
            if (misfit := each.estimator.edge_misfit(now_s, point_m)) is not None
        ]
        if not near:
            return
        _, nearest = min(near, key=lambda pair: pair[0])
        covered = bool(self._presence.covered[sensor])
        if covered and nearest.estimator.comes_up(now_s, point_m):
            self._unexplained.foreign[sensor] = True
        else:
            nearest.estimator.edge(now_s, point_m, covered)

    def _note_deafness(self, now_s: float) -> None:
        """Speeds come with every SYNC: without any, presence bits have not come either."""
        if now_s - self._speeds_s > UNSEEN_S:
            self._presence.on_deafness(now_s)

    def _note_complete(self, now_s: float) -> None:
        if self._complete_s == inf and self._presence.complete:
            self._complete_s = now_s

    def _note_coming(self, now_s: float, name: str) -> None:
        """A parcel has been found: it lay there if most of its sensors have shown it all along."""
        view = self._known[name].estimator.view(now_s)
        if view is None:
            return
        under = view.near.sensors[view.distance_m < 0.0]
        under = under[self._presence.covered[under]]
        before = self._presence.changed_s[under] <= self._complete_s
        lay_there = 2 * before.sum() > len(under)
        (self._lay_there.add if lay_there else self._lay_there.discard)(name)

    def _note_guesses(self, valid: Bools, names: list[str]) -> None:
        """Parcels have been found for the first time: sensors may show each where another lies."""
        covered = self._presence.covered
        moved = {name: each for name, each in self._known.items() if each.elsewhere}
        for name, other in combinations(moved, 2):
            one, two = moved[name], moved[other]
            if {name, other} & {*names} and all(
                there.estimator.may_be(here.estimator.footprint, covered, valid)
                for here, there in ((one, two), (two, one))
            ):
                one.guessed = two.guessed = True
                change = BeliefChange(name, BeliefEvent.GUESSED, one.place, other=other)
                self._changes.append(change)

    def _look(
        self, now_s: float, valid: Bools
    ) -> tuple[dict[str, View], Coverage, tuple[Ints, ...]]:
        """The sensors around each parcel that has a pose, by its name; all, by parcels.

        Groups of those that no parcel explains besides.
        """
        seen = ((name, each.estimator.view(now_s)) for name, each in self._known.items())
        views = {name: view for name, view in seen if view is not None}
        coverage = Coverage(len(self._sensors_m), self._known, views)
        covered, silent_s = self._presence.covered, self._presence.silent_s(now_s)
        groups = self._unexplained.groups(now_s, covered, valid, coverage, silent_s)
        return views, coverage, groups

    def _agree(
        self, now_s: float, valid: Bools, views: Mapping[str, View], coverage: Coverage
    ) -> None:
        """Correct every parcel by its own sensors, and take in whether they show it."""
        covered, changed_s = self._presence.covered, self._presence.changed_s
        silent_s, old = self._presence.silent_s(now_s), self._presence.may_be_old(now_s)
        usable = valid & ~self._unexplained.foreign & ~self._unknowns.sensors
        usable &= ~self._unexplained.beside(covered & valid, coverage)
        self._alone[:] = False
        for number, (name, each) in enumerate(self._known.items()):
            if name in views:
                sensors = views[name].near.sensors
                mine = usable[sensors] & (coverage.owner[sensors] == number)
                same_s = now_s - changed_s[sensors]
                seen = Shown(
                    self._layout.sensor_cells[sensors],
                    covered[sensors],
                    mine,
                    silent_s[sensors],
                    same_s,
                    old[sensors],
                )
                each.estimator.agree(now_s, views[name], seen)
                self._alone[sensors] |= each.estimator.alone
                each.keep_place(now_s)

    def _watch_unknown(
        self, now_s: float, valid: Bools, coverage: Coverage, groups: tuple[Ints, ...]
    ) -> None:
        """Take in groups that no parcel explains, but for those that may be a doubtful parcel."""
        if not self._presence.complete:
            return
        if not groups and self._unknowns.idle:
            return  # as nearly always
        claimed = coverage.disputed & ~self._unexplained.foreign & ~self._unknowns.sensors
        parts = [part for group in groups if len(part := group[~claimed[group]])]
        free = valid & ~self._presence.covered
        search, mute = self._parcel_search, self._presence.mute(now_s)
        self._unknowns.step(
            now_s, parts, free, mute=mute, heaps=search.heaps, settled=search.settled
        )

    def _judge(
        self,
        now_s: float,
        views: Mapping[str, View],
        coverage: Coverage,
        groups: tuple[Ints, ...],
    ) -> None:
        """Judge what each sensor is worth where all parcels are found that have ever been."""
        waiting = [each for each in self._known.values() if each.standing is not Standing.FOUND]
        if not self._known or not all(each.expected for each in waiting):
            return
        other = self._unexplained.large(groups) | self._unexplained.foreign
        other |= self._unexplained.just_left(now_s)
        for each in waiting:
            if each.awaited_at is not None:
                other |= each.awaited_at
        for name, view in views.items():
            # As the parcel may be turned, these are under it or not.
            unsure = abs(view.distance_m) < self._known[name].estimator.unsure_turn_m
            other[view.near.sensors[unsure]] = True
        self._faulty += self._presence.judge(now_s, coverage.distance_m, other, self._alone)

    def _expect_obstacles(self, groups: tuple[Ints, ...], coverage: Coverage) -> None:
        """A thing just beside a parcel from before all cells had reported is an obstacle at once.

        The parcel would be there before the thing has been steady long enough.
        """
        for group in groups:
            lay_there = self._presence.changed_s[group].max() <= self._complete_s
            if lay_there and coverage.distance_m[group].min() < _AT_ONCE_M:
                self._unknowns.expect(group)

    def _leave_obstacles(self, views: Mapping[str, View]) -> None:
        """Where a parcel was lost just now, the sensors that are still covered show an obstacle.

        Nothing may drive there before the search has found the parcel again.
        """
        for name, view in views.items():
            if self._known[name].standing is Standing.LOST:
                beside = view.near.sensors[view.distance_m < BESIDE_M]
                self._unknowns.expect(beside[self._presence.covered[beside]])

    def _is_anything_at(self, known: TrackedParcel, view: View | None, coverage: Coverage) -> bool:
        """Whether sensors are covered under a parcel, or where a lost one was believed last.

        They are of two cells or more: one alone may be broken, and no parcel lies on one. Sensors
        that another parcel explains do not show a lost one.
        """
        covered = self._presence.covered
        if view is not None:
            under = view.near.sensors[view.distance_m < 0.0]
            return len(np.unique(self._layout.sensor_cells[under[covered[under]]])) > 1
        if known.last is None:
            return False
        near, footprint = known.estimator.near(known.last), known.estimator.footprint
        under = near.sensors[footprint.distance_m(near.sensors_m, known.last) < 0.0]
        shown = under[covered[under] & ~coverage.explained[under]]
        return len(np.unique(self._layout.sensor_cells[shown])) > 1

    def _is_misjudged(
        self, now_s: float, name: str, views: Mapping[str, View], coverage: Coverage
    ) -> bool:
        """Whether reports that were late show that something else has come."""
        if name not in views or not self._known[name].is_judged_again(now_s):
            return False
        view = views[name]
        sensors = view.near.sensors
        presence, own = self._presence, coverage.owner[sensors] == coverage.number[name]
        learned_s = np.where(own, presence.changed_s[sensors], -inf)
        since_s, covered = presence.since_s[sensors], presence.covered[sensors]
        return self._known[name].judged_early(view, covered, since_s, learned_s)

    def _withdraw(self, name: str) -> None:
        """A parcel has not come; sensors that contradicted it are believed again."""
        none = self._known.pop(name)
        if none.disbelieved is not None:
            self._presence.believe(none.disbelieved)
        self._withdrawn.append((none.parcel, none.infeed))
        self._changes.append(BeliefChange(name, BeliefEvent.WITHDRAWN, none.place))

    def _leave(self, name: str) -> None:
        """A parcel is none of this table any more, nor are sensors that still show it."""
        gone = self._known.pop(name)
        view = gone.estimator.view(self._now_s)
        if view is not None:
            left = view.near.sensors[view.distance_m < BESIDE_M]
            self._unexplained.leave(self._now_s, left)
        self._changes.append(BeliefChange(name, BeliefEvent.DEPARTED, gone.place))


def _refuse_far_larger(unknown: str, corners_m: Floats, parcel: Parcel) -> None:
    """Raises ValueError for a parcel of more than twice the size that an outline has at most.

    Sensors do not show how far a thing reaches over the edge. More than half of it is on the table.
    """
    along_m, across_m = np.ptp(corners_m, axis=0).tolist()
    if 2 * parcel.footprint.reach_m > _FAR_LARGER * np.hypot(along_m, across_m):
        raise ValueError(
            f"{unknown} is {1000 * along_m:.0f} mm x {1000 * across_m:.0f} mm at most, so it is no "
            f"parcel of {1000 * parcel.length_m:.0f} mm x {1000 * parcel.width_m:.0f} mm; give its "
            "own size"
        )


def _refuse_far_larger_than_table(parcel: Parcel, layout: Layout) -> None:
    """Raises ValueError for a parcel of more than twice the table's size: it is in millimetres."""
    along_m, across_m = layout.columns * layout.pitch_m, layout.rows * layout.pitch_m
    if parcel.footprint.reach_m > np.hypot(along_m, across_m):
        raise ValueError(
            f"{parcel.name} has {2 * parcel.footprint.reach_m:.3g} m from corner to corner, but "
            f"the table has {along_m:.3g} m x {across_m:.3g} m; give its size in metres"
        )
