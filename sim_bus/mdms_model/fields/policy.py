"""The paper's policies: references so low that all wheels roll, or so high that all slide at rest.

A rolling policy is for closed loops, which take a parcel's motion from its wheels; a sliding one
centres a parcel by the mass-spring dynamics of an inward field (paper, section 4).
"""

from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import build_cells
from mdms_model.arrays import Floats
from mdms_model.errors import InputError
from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_model.statics.limits import (
    equilibrium_n,
    parcel_limits,
    rolling_equilibrium_max_m_s,
    rolling_max_m_s,
    sliding_min_m_s,
)

#: So much above the limit of eq (15) a wheel is set by a clamp: on the wire are micrometres/s.
CLEAR = 1e-3


class PolicyError(InputError):
    """References outside a policy's limit, or a parcel for which it has none."""


@dataclass(frozen=True, slots=True)
class Bound:
    """The references that a policy allows, for the parcel that bounds them most.

    Wheels that carry less than `normal_n` may slip under a policy that all roll.
    """

    policy: str
    parcel: str
    limit_m_s: float
    rolling_equilibrium_max_m_s: float
    normal_n: float

    def __str__(self) -> str:
        limit = f"{self.limit_m_s:.4g} m/s"
        if self.policy == "sliding":
            return f"all wheels slide under parcel {self.parcel!r} at rest from {limit} on (eq 15)"
        return (
            f"all wheels that carry {self.normal_n:.3g} N of parcel {self.parcel!r} roll in all "
            f"motions up to {limit} (eq 14), and at rest up to "
            f"{self.rolling_equilibrium_max_m_s:.4g} m/s (eq 17)"
        )

    def outside(self, reference_m_s: Floats) -> Floats:
        """Which references are outside; a wheel set to 0 pushes nowhere and is in no policy."""
        speed_m_s = abs(reference_m_s)
        if self.policy == "rolling":
            return np.asarray(speed_m_s > self.limit_m_s)
        return np.asarray((speed_m_s < self.limit_m_s) & (speed_m_s > 0.0))

    def clamp(self, reference_m_s: Floats, cell: NDArray[np.int64]) -> Floats:
        """The references (W,) within the bound; `cell` (W,) has the cell of each wheel.

        To roll, the wheels of a cell are slowed alike, so that it pushes the way it did. Where
        wheels slide the push does not depend on their speed, so that each is sped up alone.
        """
        if self.policy == "sliding":
            raised_m_s = np.copysign(self.limit_m_s * (1 + CLEAR), reference_m_s)
            return np.where(self.outside(reference_m_s), raised_m_s, reference_m_s)
        fastest_m_s = np.zeros(int(cell.max()) + 1)
        np.maximum.at(fastest_m_s, cell, abs(reference_m_s))
        slowed = np.minimum(1.0, self.limit_m_s / np.maximum(fastest_m_s, self.limit_m_s))
        return np.asarray(reference_m_s * slowed[cell])


def bound_of(scenario: Scenario) -> Bound | None:
    """The limits of the scenario's policy with its parcels; None without a policy.

    Raises PolicyError where it allows nothing, and `ScenarioError` for a parcel that tips in every
    pose.
    """
    policy = scenario.motion.policy
    if policy is None:
        return None
    frictions = [cell.friction for cell in build_cells(scenario)]
    friction = min(frictions) if policy == "rolling" else max(frictions)
    rubbed = replace(scenario, cell=replace(scenario.cell, friction=friction))
    bound = _rolling if policy == "rolling" else _sliding
    bounds = [bound(rubbed, parcel) for parcel in scenario.parcel]
    return (min if policy == "rolling" else max)(bounds, key=lambda bound: bound.limit_m_s)


def _rolling(scenario: Scenario, parcel: Parcel) -> Bound:
    """Eqs (14) and (17), for the least normal force or what counts as light above it."""
    limits, share = parcel_limits(scenario, parcel), scenario.motion.light_share
    weight_n = parcel.mass_kg * scenario.run.gravity_m_s2
    normal_n = max(limits.normal_min_n, share * weight_n / limits.supports_max)
    drive, friction = drive_of(scenario.cell), scenario.cell.friction
    limit_m_s = rolling_max_m_s(drive, friction, normal_n)
    if limit_m_s == 0.0:
        raise PolicyError(
            f"motion.policy is 'rolling', but a wheel under parcel {parcel.name!r} carries nothing "
            "in some pose (eq 2), so that eq (14) allows no reference at all; let wheels slip that "
            "carry little, as in motion.light_share=0.3, or leave motion.policy out"
        )
    rest_m_s = rolling_equilibrium_max_m_s(drive, friction, normal_n)
    return Bound("rolling", parcel.name, limit_m_s, rest_m_s, normal_n)


def _sliding(scenario: Scenario, parcel: Parcel) -> Bound:
    """Eq (15), for the greatest normal force under the centred parcel."""
    drive, friction = drive_of(scenario.cell), scenario.cell.friction
    normal_n = equilibrium_n(scenario, parcel)
    if not isfinite(normal_n):
        raise PolicyError(
            f"motion.policy is 'sliding', but parcel {parcel.name!r} tips at the array's centre, "
            "so that eq (15) has no limit; take a larger parcel, or leave motion.policy out"
        )
    limit_m_s = sliding_min_m_s(drive, friction, normal_n)
    rest_m_s = rolling_equilibrium_max_m_s(drive, friction, normal_n)
    return Bound("sliding", parcel.name, limit_m_s, rest_m_s, normal_n)
