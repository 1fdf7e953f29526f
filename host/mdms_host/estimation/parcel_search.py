"""The search for parcels that are not found, wherever covered sensors stand still."""

from collections.abc import Iterable

import numpy as np

from mdms_host.estimation.belief import BeliefChange, BeliefEvent, Standing
from mdms_host.estimation.pose.estimator import BESIDE_M
from mdms_host.estimation.presence import PresenceMap, Surroundings
from mdms_host.estimation.roll_call import Found, RollCall, SensorScene
from mdms_host.estimation.tracked_parcel import TrackedParcel
from mdms_host.estimation.unexplained_sensors import UnexplainedSensors
from mdms_host.estimation.unknowns import Unknowns
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Ints


class ParcelSearch:
    """Finds parcels over covered sensors that nothing explains; one search a step.

    A search takes long. `settled` is whether everything has been tried.
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
        self._faulty: list[tuple[int, list[int]]] = []
        self._misfits: list[BeliefChange] = []
        self.settled = True

    @property
    def heaps(self) -> set[bytes]:
        """Groups of covered sensors that are several parcels, as bytes."""
        return self._roll_call.heaps

    def take_faulty(self) -> list[tuple[int, list[int]]]:
        """Cells (from 1) with sensors (from 0) without which parcels were found."""
        faulty, self._faulty = self._faulty, []
        return faulty

    def take_misfits(self) -> list[BeliefChange]:
        """Things that were named as parcels, and do not have their outlines."""
        misfits, self._misfits = self._misfits, []
        return misfits

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
        self._faulty += self._presence.disbelieve(wrong)
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
                self._misfits.append(
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
