"""How much faster the wheels under a parcel may be than it is, where all of them slip alike.

No speed of a wheel shows that, but their pushes do. A parcel gains what its wheels push it to, and
wheels that gain more than that slip. The surplus of their gain is how much faster they are.
"""

from math import exp

import numpy as np

from mdms_model.arrays import Floats

#: Motors differ: wheels that roll seem to gain so much more than they push to, or less [m/s2].
_ROLLING_SHARE = 0.08
_ROLLING_M_S2 = 0.05
#: They slip once they are so much faster than that explains [m/s].
_SLIPPING_M_S = 0.018
#: They roll again where they are no faster than this [m/s].
_ROLLING_M_S = 0.005
#: They roll, too, where they push with less than this share of their push at the slip, as a mean
#: over so long [s].
_ROLLING_PUSH = 0.5
_MEAN_S = 0.03
#: A slip that is not confirmed any more is over after such a time [s].
_OVER_S = 0.2
#: How much faster they are is about the same for so long [s].
_SAME_S = 0.1


class Sliding:
    """`twist` (3,) is how much faster the wheels are than the parcel; zero where they roll.

    `corner_m` (3,) divides a twist into speeds of a corner.
    """

    def __init__(self, corner_m: Floats) -> None:
        self._corner_m = corner_m
        self._faster: Floats = np.zeros(3)
        # The part of that which rolling does not explain [m/s].
        self._unexplained_m_s = 0.0
        # Their push on the parcel, and that at which they were found to slip [m/s2].
        self._pushed: Floats = np.zeros(3)
        self._most_m_s2 = 0.0
        # Whether they do, or have done so, and whether the parcel catches up with them.
        self._slips = self._slipped = self._catching_up = False

    @property
    def twist(self) -> Floats:
        """How much faster the wheels are."""
        return self._faster * self._corner_m if self._slips else np.zeros(3)

    @property
    def variance_m2_s(self) -> float:
        """Variance of the place that the slip adds in a second [m2/s].

        It is no correction: a parcel that is lighter than believed looks the same.
        """
        return float(self._faster @ self._faster) * _SAME_S if self._slips else 0.0

    def step(self, missing: Floats, gained: Floats, step_s: float) -> None:
        """In a step wheels gained so much a second, `missing` of which did not push the parcel."""
        before, missing = self._faster, missing / self._corner_m
        gained_m_s2 = float(np.linalg.norm(gained / self._corner_m))
        rolling_m_s2 = _ROLLING_M_S2 + _ROLLING_SHARE * gained_m_s2
        missing_m_s2 = float(np.linalg.norm(missing))
        self._faster = before + missing * step_s
        pushed = gained / self._corner_m - missing
        self._pushed = self._pushed + (pushed - self._pushed) * (1.0 - exp(-step_s / _MEAN_S))
        push_m_s2 = float(np.linalg.norm(self._pushed))
        if missing_m_s2 < rolling_m_s2:
            self._faster = self._faster * exp(-step_s / _OVER_S)
        slow = float(np.linalg.norm(self._faster)) < _ROLLING_M_S
        caught_up = self._catching_up and float(before @ self._faster) <= 0.0
        # Friction gives all it can while they slip.
        rolls = push_m_s2 < _ROLLING_PUSH * self._most_m_s2
        if self._slipped and (slow or caught_up or rolls):
            self.begin_again()
        if self._catching_up:
            # Speed that they lose now is no slip the other way.
            return
        same_way = float(before @ missing) >= 0.0
        unexplained_m_s2 = (missing_m_s2 if same_way else -missing_m_s2) - rolling_m_s2
        self._unexplained_m_s += unexplained_m_s2 * step_s
        if self._unexplained_m_s > 0.0:
            self._slips = self._unexplained_m_s > _SLIPPING_M_S
            if self._slips and not self._slipped:
                self._slipped, self._most_m_s2 = True, push_m_s2
        elif self._slipped:
            self._slips, self._catching_up = False, True
        else:
            self.begin_again()

    def begin_again(self) -> None:
        """The wheels roll, as far as is known."""
        self._faster, self._unexplained_m_s = np.zeros(3), 0.0
        self._slips = self._slipped = self._catching_up = False
