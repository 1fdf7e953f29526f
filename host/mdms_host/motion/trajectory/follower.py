"""Takes a parcel along its path: a reference that friction lets it follow, and feedback to it.

A late parcel harms nobody. The reference moves within a movement authority, not by the clock, and a
parcel that has been held or pushed along its path takes the reference along.

The parcel follows by the wheels' own law. A wheel that is to run at u* and to push with f* gets r =
(b u* + f* + m u*')/a, and pushes with f* + b (u* - u). So the cell feeds the error of the speed
back, a thousand times a second. The error of the pose is fed back with it, because it is added to
u*. The push is bounded with the expected speed u: f* + b (u* - u) stays within friction at that
wheel. So no wheel is asked to slip, however far off the parcel is.

Wheels that slip are to push with a share of the friction that is believed. The push of a wheel
follows from its reference and its speed (eq 9), whether it slips or not. Wheels that roll gain as
much as they push the parcel to. Wheels that all slip gain more than that: the parcel lags behind. A
parcel that is much lighter than believed looks the same, and is pushed less then.
"""

from dataclasses import dataclass
from math import exp, inf

import numpy as np

from mdms_host.estimation.belief import Belief, Gain
from mdms_host.motion.trajectory.speed_profile import Reference, SpeedProfile
from mdms_host.motion.trajectory.traction import Traction
from mdms_model.arrays import Floats, Ints

#: Cells report the speed of a wheel so late [s].
_LATE_S = 0.002
#: Means are over so long [s]; slip is judged after so many cycles of pushing with at least this
#: share of the plan, and with as much at least [m/s2]: motors that differ make for a tenth.
_MEAN_S = 0.04
_CYCLES = 6
_PUSHING_SHARE = 0.4
_PUSHING_M_S2 = 0.3
_MISSING_SHARE = 0.22
_MOST_MISSING = 0.6
#: Wheels that slip are to push with so much of their last push, but never less than the least.
_BACKED_OFF = 0.75
_LEAST_SHARE = 0.15
#: The share comes back by so much in a second.
_RESTORED_PER_S = 0.02


@dataclass(frozen=True, slots=True)
class Given:
    """The plan for the wheels (n,) under a parcel over a step.

    Their `rows` (n, 3) map a twist to speeds, and at the twist `expected` (3,) they push with
    `force_n` (n,). They push less by b (n,) times their surplus speed. `along` (3,) is the
    direction of the path, and `inertia_kg` the mass to speed up along it. `drag_n` is the most that
    wheels which do not push drag with against it: less where they turn easily. Their rims, of
    `rim_mass_kg` each, take part of the push where they gain more than `planned_m_s2`.
    """

    rows: Floats
    force_n: Floats
    expected: Floats
    b_n_s_per_m: Floats
    along: Floats
    inertia_kg: float
    drag_n: float
    rim_mass_kg: float = 0.0
    planned_m_s2: float = 0.0

    def acceleration_m_s2(self, twist: Floats, gained_m_s2: float) -> float:
        """Acceleration of the parcel along its path by the wheels, at this mean twist.

        If it has `gained_m_s2` less than it was pushed to, drag may account for that, as far as it
        can.
        """
        force_n = self.force_n + self.b_n_s_per_m * (self.rows @ (self.expected - twist))
        pushed_m_s2 = float((self.rows @ self.along) @ force_n) / self.inertia_kg
        dragged_m_s2 = max(0.0, min(pushed_m_s2 - gained_m_s2, self.drag_n / self.inertia_kg))
        return pushed_m_s2 - dragged_m_s2

    def taken_m_s2(self, gained_m_s2: float) -> float:
        """The part of that acceleration which does not reach the parcel at such a gain.

        Speeds are reported late, and the wheels' own rims have to be sped up.
        """
        per_m2 = (self.rows @ self.along) ** 2
        faster_m_s2 = gained_m_s2 - self.planned_m_s2
        late_n = _LATE_S * gained_m_s2 * float(per_m2 @ self.b_n_s_per_m)
        rims_n = self.rim_mass_kg * faster_m_s2 * float(per_m2.sum())
        return (late_n + rims_n) / self.inertia_kg


class Grip:
    """`share` is the usable part of the planned pushes: 1 until wheels slip.

    `slips` counts how often it has been reduced.
    """

    def __init__(self) -> None:
        self.share = 1.0
        self.slips = 0
        self._cycles = 0
        self._gained = self._pushed = 0.0

    def begin_again(self) -> None:
        """Forget the gains and pushes of late."""
        self._cycles, self._gained, self._pushed = 0, 0.0, 0.0

    def step(
        self, gained_m_s2: float, pushed_m_s2: float, planned_m_s2: float, step_s: float
    ) -> None:
        """Take in the gain of the wheels in a step, and the gain that their pushes explain.

        `planned_m_s2` is the most that they can be asked for, without the share.
        """
        self.share = min(1.0, self.share + _RESTORED_PER_S * step_s)
        if gained_m_s2 * self._gained < 0.0:
            self.begin_again()
        weight = 1.0 - exp(-step_s / _MEAN_S)
        self._gained += weight * (gained_m_s2 - self._gained)
        self._pushed += weight * (pushed_m_s2 - self._pushed)
        least_m_s2 = max(_PUSHING_SHARE * self.share * planned_m_s2, _PUSHING_M_S2)
        if abs(self._gained) < least_m_s2:
            self._cycles = 0
            return
        self._cycles += 1
        missing = min(1.0 - self._pushed / self._gained, _MOST_MISSING)
        if self._cycles >= _CYCLES and missing > _MISSING_SHARE:
            self.share = max(_LEAST_SHARE, _BACKED_OFF * (1.0 - missing) * self.share)
            self.slips += 1
            self.begin_again()


#: The error of the pose becomes a speed towards the path [1/s], so much at most [m/s].
STIFFNESS_PER_S = 8.0
_FED_BACK_M_S = 0.05
#: The error of the speed is to vanish at this rate at least [1/s], if need be with so much more
#: feedback than by the wheels' own law.
_HURRY_PER_S = 25.0
_MOST_HURRY = 6.0
#: A parcel that is farther from its reference along the path takes it along [m].
_REJOIN_M = 0.012
#: How far back and ahead it may then be found again [m].
_SEARCH_M = 0.3
#: A parcel that is farther beside its path has left it [m].
_OFF_PATH_M = 0.02
#: A belief farther from where its twist leads has been corrected by a sensor [m].
_SET_RIGHT_M = 0.001


@dataclass(frozen=True, slots=True)
class Carried:
    """Motion of the wheels under one parcel in the next step [table frame; SI].

    `reference` (3,) is how the parcel is to move along its path, `twist` the same with feedback,
    and `expected` how it is expected to move, all in the middle of the step. `acceleration` is that
    of the reference. `wheels` (n,) carry the parcel, and at the expected twist are to push with
    `force_n` (n,). `gain` is their gain before.
    """

    pose: Floats
    reference: Floats
    twist: Floats
    expected: Floats
    acceleration: Floats
    wheels: Ints
    force_n: Floats
    gain: Gain | None = None


class Follower:
    """Follows one profile with one parcel; `step` once a cycle.

    `reference` is where the parcel is to be on its path, and how fast, a corner's way included.
    `paused` brings it to rest on its path, for as long as it is set. `off_path` is whether the
    parcel has left its path by so much that it is brought to rest, for the caller to plan anew.
    `grip` is the estimate of slip, and may be that of an earlier follower of the parcel. `gain` is
    the gain of the wheels in the step before the last call, if it is known.
    """

    def __init__(self, traction: Traction, profile: SpeedProfile, grip: Grip | None = None) -> None:
        self.profile = profile
        self.grip = grip or Grip()
        self.gain: Gain | None = None
        self.paused = False
        self.off_path = False
        self._traction = traction
        self._made = traction.changes
        self.reference = Reference(profile)
        self._pose: Floats | None = None
        self._twist: Floats | None = None
        self._rate: Floats = np.zeros(3)
        # The plan of the past step, and of the next one.
        self._ended: Given | None = None
        self._going: Given | None = None

    @property
    def out_of_date(self) -> bool:
        """Whether other wheels push now than when the profile was made."""
        return self._made != self._traction.changes

    def step(self, belief: Belief, step_s: float, authority_s_m: float = inf) -> Carried:
        """Motion of the wheels in the step that begins at the belief's time.

        The parcel stops before the path coordinate of the authority, as far as it still can.
        """
        self._check_grip(belief, step_s)
        self._rejoin(belief)
        reference = self.reference
        before_s_m, before_m_s = reference.s_m, reference.speed_m_s
        if self.paused or self.off_path:
            reference.brake(step_s)
        else:
            reference.advance(step_s, authority_s_m)
        return self._carry(belief, before_s_m, before_m_s, step_s)

    def _check_grip(self, belief: Belief, step_s: float) -> None:
        """Compare the gain of the wheels in the step that has just ended with their pushes.

        Not where the belief has just been corrected: at another place the same speeds of wheels
        make another twist. Nor after a time without speeds: the gain in all of it would count as
        one of a step.
        """
        ended, before, last, twist = self._ended, self._twist, self._pose, belief.twist
        self._twist, self._pose = twist, belief.pose
        self.gain = None
        if ended is None or before is None or last is None:
            return
        jumped = belief.pose - last - twist * step_s
        if self.profile.path.distance_m(jumped) > _SET_RIGHT_M or self.paused or belief.unseen:
            self.grip.begin_again()
            return
        # A twist and the direction of the path have their product in metres of a corner's way.
        metric = (1.0, 1.0, self.profile.path.reach_m**2)
        gained_m_s2 = float(((twist - before) * metric) @ ended.along) / step_s
        pushed_m_s2 = ended.acceleration_m_s2((twist + before) / 2, gained_m_s2)
        pushed_m_s2 -= ended.taken_m_s2(gained_m_s2)
        missing_m_s2 = gained_m_s2 - pushed_m_s2
        self.gain = Gain(gained_m_s2 * ended.along, missing_m_s2 * ended.along)
        planned_m_s2 = self.profile.acceleration_at(self.reference.s_m)
        self.grip.step(gained_m_s2, pushed_m_s2, planned_m_s2, step_s)
        self.reference.share = self.grip.share

    def _rejoin(self, belief: Belief) -> None:
        """Find a parcel that is far from its reference again on its path, or off it."""
        path, s_m = self.profile.path, self.reference.s_m
        if path.distance_m(path.off(belief.pose, s_m)) <= _REJOIN_M:
            return
        ends_m = max(0.0, s_m - _SEARCH_M), min(s_m + _SEARCH_M, self.reference.stop_at())
        nearest_m = path.nearest_m(belief.pose, *ends_m)
        if abs(nearest_m - s_m) > _REJOIN_M:
            self.reference.join(nearest_m, path.speed_m_s(belief.twist, nearest_m))
        beside_m = path.distance_m(path.off(belief.pose, nearest_m))
        self.off_path = self.off_path or beside_m > _OFF_PATH_M

    def _carry(
        self, belief: Belief, before_s_m: float, before_m_s: float, step_s: float
    ) -> Carried:
        speed_m_s, middle_m = self.reference.speed_m_s, (before_s_m + self.reference.s_m) / 2
        along = self.profile.path.direction_at(middle_m)
        rate = along * ((speed_m_s - before_m_s) / step_s)
        # The belief's twist is of the last SYNC, one cycle before, and its pose carried on by that.
        pose = belief.pose + self._rate * (step_s**2 / 2)
        expected = belief.twist + self._rate * step_s + rate * (step_s / 2)
        reference = along * ((speed_m_s + before_m_s) / 2)
        twist = reference + self._fed_back(pose, before_s_m)
        self._rate = rate
        wheels, push_n, most_n, resists = self._pushes(middle_m, rate, along)
        rows = self._traction.layout.surface_jacobian(*pose[:2].tolist())[wheels]
        b = self._traction.drives.b_n_s_per_m[wheels]
        hurried = self._hurry(b) * b * (rows @ (twist - expected))
        force_n = np.clip(push_n + hurried, -most_n, most_n)
        planned_m_s2 = (speed_m_s - before_m_s) / step_s
        rims = self._traction.drives.rim_mass_kg, planned_m_s2
        given = Given(rows, force_n, expected, b, along, *resists, *rims) if along.any() else None
        self._ended, self._going = self._going, given
        return Carried(pose, reference, twist, expected, rate, wheels, force_n, self.gain)

    def _hurry(self, b_n_s_per_m: Floats) -> float:
        """How much more a speed that is off is to be fed back than by the wheels' own law.

        The law alone speeds a heavy parcel up slowly.
        """
        own_per_s = float(b_n_s_per_m.sum()) / 2 / self.profile.pushes[0][1].mass.mass_kg
        return max(1.0, min(_HURRY_PER_S / max(own_per_s, 1e-9), _MOST_HURRY))

    def _pushes(
        self, s_m: float, rate: Floats, along: Floats
    ) -> tuple[Ints, Floats, Floats, tuple[float, float]]:
        """Wheels that carry (n,), their pushes for an acceleration, bounds; inertia and drag."""
        pushes, sample = self.profile.part_at(s_m)
        carrying = pushes.pushing_n[sample] > 0.0
        normal_n = pushes.pushing_n[sample, carrying]
        shares = pushes.per_wrench[sample, carrying] @ pushes.wrench_at(sample, rate)
        # Braking may take more than the share of a grip that has been reduced.
        most = np.maximum(self.grip.share * self._traction.push_share, abs(shares))
        drag_n = pushes.drag_n(sample, along, self._traction.friction)
        resists = pushes.inertia_kg(sample, along), drag_n
        return pushes.wheels[carrying], normal_n * shares, normal_n * most, resists

    def _fed_back(self, pose: Floats, s_m: float) -> Floats:
        """Twist towards the reference, shape (3,); none while the parcel is only to stop."""
        if self.paused or self.off_path:
            return np.zeros(3)
        off = self.profile.path.off(pose, s_m)
        speed_m_s = STIFFNESS_PER_S * self.profile.path.distance_m(off)
        return off * (STIFFNESS_PER_S * min(1.0, _FED_BACK_M_S / max(speed_m_s, 1e-12)))
