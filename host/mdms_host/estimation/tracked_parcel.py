"""A parcel that the tracker was given, with its estimate: found, sought, or about to leave."""

from dataclasses import replace

import numpy as np

from mdms_host.estimation.belief import Belief, BeliefChange, BeliefEvent, Standing
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.locating import Location
from mdms_host.estimation.parcel import BoundingBox, ExitLine, Parcel
from mdms_host.estimation.pose.estimator import ParcelEstimator, View
from mdms_host.estimation.presence import Surroundings
from mdms_host.estimation.roll_call import Sought
from mdms_host.estimation.size import Size
from mdms_model.arrays import Bools, Floats

#: A size that is told no better than this is to be learned; it is off by so many deviations at most
#: [m].
LEARNED_M = 0.002
_DEVIATIONS = 3.0
#: A parcel that sensors still show has left where its centre is so far past its gate [m].
_OUT_M = 0.02
#: A parcel that sensors have lost was on its way through if its centre was to be so near its gate
#: soon, as it went [m, s]. One that stands farther away was taken by a hand.
_NEARLY_OUT_M = 0.06
_SOON_S = 0.5
#: A parcel that came and is lost so soon after it was found was another thing [s].
_PROVEN_S = 2.0
#: A parcel lies elsewhere than told if it is first found so far from there [m].
_ELSEWHERE_M = 0.1
#: The outline of a parcel that came is judged again for so long after it was found, by sensors up
#: to so far beside it [s, m].
_REOPENED_S = 0.4
_OUTSIDE_M = 0.15


class TrackedParcel:
    """One parcel. `region` is the only place where it may be found, `gate` the exit to leave by.

    `place` is the pose of its last finding, or the expected pose; None where it may be anywhere.
    `unknown` is the name that it had as an unknown thing, before it was given an outline.
    """

    def __init__(
        self,
        parcel: Parcel,
        surroundings: Surroundings,
        *,
        region: BoundingBox | None = None,
        unknown: str | None = None,
    ) -> None:
        self.parcel = parcel
        self.estimator = ParcelEstimator(surroundings, parcel.footprint, parcel.spread_m)
        self.region = region
        #: The sensors (S,) of that region.
        self.awaited_at = None if region is None else region.holds(surroundings.sensors_m)
        #: Where it was announced.
        self.infeed = region if unknown is None else None
        #: Sensors (S,) that contradicted where it was found, and are not believed.
        self.disbelieved: Bools | None = None
        self._found_s: float | None = None
        #: Whether it was first found elsewhere than told; None before.
        self.elsewhere: bool | None = None
        #: Whether it may be another one that looks alike, as a person was told.
        self.guessed = False
        #: Where it was found last; None while it is not.
        self._found_m: Floats | None = None
        self.unknown = unknown
        self.gate: ExitLine | None = None
        self.expected = region is not None
        self.place: Floats | None = None
        #: How fast it went while that was sure.
        self._went_m_s: Floats = np.zeros(2)
        #: Its pose when it was last believed anywhere, sure or not.
        self.last: Floats | None = None
        if parcel.near_m is not None:
            self.place = np.array([*parcel.near_m, parcel.yaw_hint_rad])
        self._reported = Standing.LOST

    @property
    def standing(self) -> Standing:
        """The standing of its belief."""
        return self.estimator.standing

    @property
    def sought(self) -> Sought:
        """The target of a search for it, while it is not found."""
        place = self.place
        yaw_rad = self.parcel.yaw_hint_rad if place is None else float(place[2])
        return Sought(self.parcel.name, self.estimator.footprint, yaw_rad, place, self.region)

    @property
    def size(self) -> Size | None:
        """How large it is, as far as edges have shown it by now; None where it is no rectangle."""
        footprint = self.estimator.footprint
        if not isinstance(footprint, Rectangle):
            return None
        along_m, across_m = self.estimator.growth_deviation_m
        yaw_rad = self.parcel.yaw_hint_rad if self.place is None else float(self.place[2])
        return Size(footprint.length_m, footprint.width_m, (2 * along_m, 2 * across_m), yaw_rad)

    @property
    def learns(self) -> bool:
        """Whether its size is to be learned."""
        return self.parcel.shape == "rectangle" and self.parcel.spread_m > LEARNED_M

    def of_any_size(self, found: Location, poses: Floats, sides_m: Floats) -> Location:
        """The place where it has been found, by the poses and sides that the sensors allow.

        Sides too far from the given size do not count. Others count by how likely the given size
        makes them. All count alike for a thing whose size is known by the same sensors.
        """
        off_m = (sides_m - (self.parcel.length_m, self.parcel.width_m)) / 2
        deviations = off_m / self.parcel.spread_m
        may_be = (abs(deviations) < _DEVIATIONS).all(axis=1)
        if not may_be.any():
            return found
        told = np.exp(-(deviations[may_be] ** 2).sum(axis=1) / 2)
        return replace(
            found,
            poses=poses[may_be],
            weights=told if self.unknown is None else np.ones(len(told)),
            grid=np.zeros(3),
            growths=off_m[may_be],
        )

    def belief(self, at_s: float, usable: Bools | None) -> Belief | None:
        """The belief of it at a time near now; None without a pose.

        With `usable` sensors (S,), the belief has the moves that would make the place surer.
        """
        one = self.estimator
        corrected, one.corrected = one.corrected, False
        pose = one.pose_at(at_s)
        if pose is None:
            return None
        feel = () if usable is None else one.moves_to_feel(usable)
        return Belief(
            self.parcel.name,
            one.footprint,
            pose,
            one.twist,
            one.covariance,
            one.standing,
            corrected,
            feel,
            unseen=one.unseen,
        )

    def look_again(self, deviation_m: float) -> None:
        """Sensors count again. Its wheels have carried it on meanwhile, perhaps out of its gate.

        It may have moved by so much besides, as a deviation.
        """
        if self.estimator.pose is not None:
            self.last = self.estimator.pose.copy()
        self.estimator.blur(deviation_m)

    def keep_place(self, now_s: float) -> None:
        """Remember where it is, as long as that is sure; once found, it may be anywhere later."""
        if self.standing is not Standing.FOUND:
            self._found_m = None
        if self.estimator.pose is None:
            return
        self.last = self.estimator.pose.copy()
        if self.standing is Standing.FOUND:
            self._found_m = self.last[:2] if self._found_m is None else self._found_m
            self._found_s = now_s if self._found_s is None else self._found_s
            if self.elsewhere is None:
                told_m = self.last[:2] if self.parcel.near_m is None else self.parcel.near_m
                self.elsewhere = bool(np.hypot(*(self.last[:2] - told_m)) > _ELSEWHERE_M)
            self.place, self.expected = self.last, False
            self._went_m_s = self.estimator.twist[:2].copy()
            self.region = self.awaited_at = None

    def was_none(self, now_s: float) -> bool:
        """Whether something else was taken for it as it was to come.

        A parcel that was carried away from its infeed has come.
        """
        if self.infeed is None or self._found_s is None or self.last is None:
            return False
        lost = self.standing is Standing.LOST and bool(self.infeed.holds(self.last[None, :2])[0])
        return lost and now_s < self._found_s + _PROVEN_S

    def is_judged_again(self, now_s: float) -> bool:
        """Whether it came so lately that its outline may turn out to be another."""
        if self.infeed is None or self._found_s is None:
            return False
        return now_s <= self._found_s + _REOPENED_S

    def judged_early(self, view: View, covered: Bools, since_s: Floats, learned_s: Floats) -> bool:
        """Whether a parcel that has just come has another outline than it was taken for.

        All are of the sensors of the view, (N,). A change that was learned after the parcel was
        found, and may be older, was there by then, and contradicts it.
        """
        if self._found_s is None:
            return False
        deep = abs(view.distance_m) > self.estimator.unsure_m
        near = view.distance_m < _OUTSIDE_M
        wrong = (view.distance_m < 0.0) != covered
        older = (learned_s > self._found_s) & (since_s < self._found_s)
        return bool((deep & near & wrong & older).any())

    def has_left(self, shown: bool) -> bool:
        """Whether it is past its gate, or was on its way through when sensors lost it.

        `shown` is whether any sensor is covered where it is, or was, believed. Then a parcel that
        is doubtful or lost, or that stands at the edge, is still there: its place is not known to
        the mm. A parcel that was found past its gate is there too: none can lie without support.
        """
        if self.gate is None or self.place is None or self.last is None or self.expected:
            return False
        if self.standing is Standing.FOUND:
            past_m = float(self.gate.past_m(self.place[:2]))
            if not shown:
                return past_m >= 0.0
            found_m = self.place[:2] if self._found_m is None else self._found_m
            return past_m >= _OUT_M and float(self.gate.past_m(found_m)) < 0.0
        if shown or not self.gate.reached_by(self.estimator.footprint, self.last):
            return False
        soon_m = self.last[:2] + _SOON_S * self._went_m_s
        return float(self.gate.past_m(soon_m)) >= -_NEARLY_OUT_M

    def take_change(self) -> BeliefChange | None:
        """That its standing is another than at the last call."""
        if self.standing is self._reported:
            return None
        self._reported = self.standing
        return BeliefChange(self.parcel.name, BeliefEvent(self.standing.value), self.estimator.pose)
