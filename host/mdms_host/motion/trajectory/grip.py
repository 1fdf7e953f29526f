"""The share of the believed friction that seems to be there: less where wheels slip.

The push of a wheel follows from its reference and its speed (eq 9), whether it slips or not. Wheels
that roll gain as much as they push the parcel to. Wheels that all slip gain more than that: the
parcel lags behind. A parcel that is much lighter than believed looks the same, and is pushed less
then.
"""

from dataclasses import dataclass
from math import exp

from mdms_model.arrays import Floats

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
