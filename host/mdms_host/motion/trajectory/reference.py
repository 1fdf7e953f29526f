"""The reference (s, s'): the wanted place of a parcel on its path, and its speed.

It starts at the parcel's place, speeds up as the profile's bounds allow, and can at any time stop
before the movement authority, the path coordinate up to which the way is free.
"""

from math import inf, sqrt

from mdms_host.motion.trajectory.speed_profile import SpeedProfile

#: It is where it is to stop within this [m].
_THERE_M = 2e-5
#: Rounds in which the speed after a step is found: to a thousandth of the change in a step.
_ROUNDS = 12


class Reference:
    """Path coordinate `s_m` and speed `speed_m_s` on a profile, from rest at its start.

    `share` of the bounds of acceleration is made use of; more only for braking, where it cannot be
    helped: wheels that slip brake as well as friction can.
    """

    def __init__(self, profile: SpeedProfile) -> None:
        self.profile = profile
        self.share = 1.0
        self.s_m = 0.0
        self.speed_m_s = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether it stands."""
        return self.speed_m_s == 0.0

    @property
    def finished(self) -> bool:
        """Whether it stands at the end of the path."""
        return self.at_rest and self.s_m >= self.profile.path.length_m

    @property
    def stopping_s(self) -> float:
        """How long it takes to come to rest from here [s]."""
        return 0.0 if self.at_rest else self.speed_m_s / self._bound_m_s2

    @property
    def _bound_m_s2(self) -> float:
        return self.profile.acceleration_at(self.s_m)

    @property
    def committed_s_m(self) -> float:
        """The path coordinate before which it cannot stop any more."""
        end_m = self.profile.stopping_end(self.s_m, self.speed_m_s)
        return min(end_m, self.profile.stop_after(self.s_m))

    def brake(self, step_s: float) -> None:
        """Move on by a step, and towards rest."""
        self._move(max(0.0, self.speed_m_s - self._bound_m_s2 * step_s), step_s)

    def advance(self, step_s: float, authority_s_m: float = inf) -> None:
        """Move on by a step, as fast as it may.

        Where the authority is nearer than it can stop, it overruns that, braking.
        """
        slowest_m_s = max(0.0, self.speed_m_s - self._bound_m_s2 * step_s)
        stop_m = min(self.profile.stop_after(self.s_m + _THERE_M), authority_s_m)
        left_m = stop_m - self.s_m
        if slowest_m_s == 0.0 and 0.0 <= left_m <= self.speed_m_s * step_s / 2 + _THERE_M:
            self.s_m, self.speed_m_s = stop_m, 0.0
        else:
            self._move(self._next_m_s(slowest_m_s, step_s, stop_m), step_s)

    def join(self, s_m: float, speed_m_s: float) -> None:
        """Go on from elsewhere on the path, where it may at this speed."""
        allowed_m_s = sqrt(max(self.share * self.profile.ahead_at(s_m), 0.0))
        self.s_m, self.speed_m_s = s_m, min(max(speed_m_s, 0.0), allowed_m_s)

    def stop_at(self) -> float:
        """The path coordinate at which it rests next, or rests now."""
        return self.profile.stop_after(self.s_m - _THERE_M)

    def _next_m_s(self, slowest_m_s: float, step_s: float, stop_m: float) -> float:
        """The greatest speed after the step, of those that friction allows, that can be stopped."""
        gained_m_s = self.share * self._bound_m_s2 * step_s
        low_m_s, high_m_s = slowest_m_s, self.speed_m_s + gained_m_s
        if self._can_stop(high_m_s, step_s, stop_m):
            return high_m_s
        if not self._can_stop(low_m_s, step_s, stop_m):
            return low_m_s
        for _ in range(_ROUNDS):
            middle_m_s = (low_m_s + high_m_s) / 2
            if self._can_stop(middle_m_s, step_s, stop_m):
                low_m_s = middle_m_s
            else:
                high_m_s = middle_m_s
        return low_m_s

    def _can_stop(self, speed_m_s: float, step_s: float, stop_m: float) -> bool:
        """Whether, at this speed after the step, all that is ahead can be met, and the stop too."""
        s_m = self.s_m + (self.speed_m_s + speed_m_s) / 2 * step_s
        if s_m > stop_m:
            return False
        profile = self.profile
        gained = min(profile.climb(stop_m) - profile.climb(s_m), profile.ahead_at(s_m) / 2)
        return speed_m_s**2 <= 2 * self.share * gained + 1e-12

    def _move(self, speed_m_s: float, step_s: float) -> None:
        s_m = self.s_m + (self.speed_m_s + speed_m_s) / 2 * step_s
        self.s_m, self.speed_m_s = min(s_m, self.profile.path.length_m), speed_m_s
