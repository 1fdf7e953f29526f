"""The paper's reduced dynamics: a mass on a spring where wheels slide, a damper where they roll."""

from dataclasses import dataclass

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.motor import Drive


@dataclass(frozen=True, slots=True)
class SlidingLaw:
    """Net force with all wheels slipping, f = spring x_c + offset (eq 6)."""

    spring_n_per_m: float
    """k_s; negative where the wheels push the parcel back."""
    offset_n: float
    """f_o at x_c = 0, the origin of the table."""

    @property
    def equilibrium_m(self) -> float:
        """The centre of mass without net force; inf or nan where there is none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.float64(-self.offset_n) / self.spring_n_per_m)

    def period_s(self, mass_kg: float) -> float:
        """Of the swing about a stable equilibrium, as long as the supports stay."""
        return float(2 * np.pi * np.sqrt(mass_kg / -self.spring_n_per_m))


@dataclass(frozen=True, slots=True)
class RollingLaw:
    """Net force with all wheels rolling, f = offset - damping v (eq 11)."""

    offset_n: float
    """f_o, in proportion to the sum of the references."""
    damping_ns_per_m: float
    """b, of all wheels together."""

    @property
    def speed_m_s(self) -> float:
        """The goal of the parcel's motion: the mean of the free wheels' speeds."""
        return self.offset_n / self.damping_ns_per_m


def sliding_law(
    wheel_x_m: Floats, wheel_speed: Floats, friction: float, weight_n: float
) -> SlidingLaw:
    """k_s and f_o of a set of supports from the signs of their wheels' speeds (eqs 4 to 6)."""
    sign, arm_m = np.sign(wheel_speed), wheel_x_m - wheel_x_m.mean()
    spring = friction * weight_n * float(sign @ arm_m) / float(arm_m @ arm_m)
    even = friction * weight_n * float(sign.mean())
    return SlidingLaw(spring, even - spring * float(wheel_x_m.mean()))


def rolling_law(drive: Drive, reference_m_s: Floats) -> RollingLaw:
    """f_o and b of a set of supports from their wheels' references (eqs 10 and 11)."""
    return RollingLaw(drive.a * float(reference_m_s.sum()), drive.b * len(reference_m_s))
