"""The paper's bounds: normal forces (eqs 2 and 3) and reference speeds (eqs 12 to 17).

The paper derives them for one row and a centred parcel longer than two pitches, away from the ends
of the row. For any other array or parcel the normal forces are searched over all poses instead, and
eqs (14) to (17) take the result for motions along any one direction.
"""

import math
from dataclasses import dataclass

from mdms_model.motor import Drive, drive_of
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_model.statics.normal_bounds import NormalBounds, centred_normal_n, search_normals


@dataclass(frozen=True, slots=True)
class ParcelLimits:
    """The limits of the wheels under a parcel; references r as in the paper, not surface speeds."""

    name: str
    supports_min: int
    supports_max: int
    normal_min_n: float
    normal_max_n: float
    rolling_max_m_s: float
    """All wheels roll in all motions below this reference (eq 14)."""
    sliding_min_m_s: float
    """All wheels slide under the centred parcel above this reference (eq 15)."""
    rolling_equilibrium_max_m_s: float
    """All wheels roll under a parcel at rest below this reference (eq 17)."""
    droop: float
    """Speed of a free wheel over its reference, a/b."""


def parcel_limits(scenario: Scenario, parcel: Parcel) -> ParcelLimits:
    """The bounds of one parcel. Raises `ScenarioError` where it tips in every pose."""
    drive, friction = drive_of(scenario.cell), scenario.cell.friction
    if is_paper_row(scenario, parcel):
        bounds = paper_bounds(scenario, parcel)
    else:
        bounds = search_normals(scenario, parcel)
    centred_n = equilibrium_n(scenario, parcel)
    return ParcelLimits(
        name=parcel.name,
        supports_min=bounds.supports_min,
        supports_max=bounds.supports_max,
        normal_min_n=bounds.normal_min_n,
        normal_max_n=bounds.normal_max_n,
        rolling_max_m_s=rolling_max_m_s(drive, friction, bounds.normal_min_n),
        sliding_min_m_s=sliding_min_m_s(drive, friction, centred_n),
        rolling_equilibrium_max_m_s=rolling_equilibrium_max_m_s(
            drive, friction, bounds.normal_min_n
        ),
        droop=drive.droop,
    )


def equilibrium_n(scenario: Scenario, parcel: Parcel) -> float:
    """Greatest normal force under the centred parcel, as in eq (15); inf: it tips [N]."""
    if is_paper_row(scenario, parcel):
        weight_n = parcel.mass_kg * scenario.run.gravity_m_s2
        return equilibrium_normal_n(parcel.length_m / scenario.array.pitch_m, weight_n)
    return centred_normal_n(scenario, parcel)


def is_paper_row(scenario: Scenario, parcel: Parcel) -> bool:
    """Whether the paper's assumptions hold: one row, the origin between cells, L > 2 d, centred."""
    array, wheels = scenario.array, scenario.cell.wheel
    row = array.rows == 1 and array.columns % 2 == 0 and len(wheels) == 1
    middle = row and wheels[0].offset_m[0] == 0.0 and parcel.yaw_rad == 0.0
    return middle and parcel.centre_of_mass_m[0] == 0.0 and parcel.length_m >= 2 * array.pitch_m


def paper_bounds(scenario: Scenario, parcel: Parcel) -> NormalBounds:
    """Eqs (2) and (3) [N]."""
    pitches = parcel.length_m / scenario.array.pitch_m
    weight_n = parcel.mass_kg * scenario.run.gravity_m_s2
    supports, _ = whole_pitches(pitches)
    return NormalBounds(
        supports, supports + 1, normal_min_n(pitches, weight_n), normal_max_n(pitches, weight_n)
    )


def whole_pitches(pitches: float) -> tuple[int, float]:
    """m and h of a parcel's length L = d (m + h)."""
    whole = math.floor(pitches + 1e-9)
    return whole, max(pitches - whole, 0.0)


def normal_min_n(pitches: float, weight_n: float) -> float:
    """Least normal force at a wheel, over all positions of a parcel of length L/d >= 2 (eq 2)."""
    m, h = whole_pitches(pitches)
    more = 1 / (m + 1) - 3 * h / ((m + 1) * (m + 2))
    fewer = (m - 2) / (m * (m + 1)) + 3 * h / (m * (m + 1))
    return min(more, fewer) * weight_n


def normal_max_n(pitches: float, weight_n: float) -> float:
    """Greatest normal force at a wheel, over all positions of a parcel of L/d >= 2 (eq 3)."""
    m, h = whole_pitches(pitches)
    more = 1 / (m + 1) + 3 * h / ((m + 1) * (m + 2))
    fewer = (m + 4) / (m * (m + 1)) - 3 * h / (m * (m + 1))
    return max(more, fewer) * weight_n


def equilibrium_normal_n(pitches: float, weight_n: float) -> float:
    """Normal force of each wheel under a centred parcel, W/(k + 1) (eq 15)."""
    m, _ = whole_pitches(pitches)
    return weight_n / ((m if m % 2 else m - 1) + 1)


def rolls(
    drive: Drive, friction: float, normal_n: float, reference_m_s: float, speed_m_s: float
) -> bool:
    """Whether a wheel rolls under a parcel that moves with `speed_m_s` (eq 12)."""
    return friction * normal_n > abs(reference_m_s * drive.a - speed_m_s * drive.b)


def rolling_max_m_s(drive: Drive, friction: float, normal_n: float) -> float:
    """References below this make every wheel roll in every motion (eqs 13 and 14).

    The worst case is a parcel that moves with the fastest reference against a wheel's own, r a +
    r b; eq (13) sums that to Be + Ke^2/Rm + 2 G Ke/Rm.
    """
    return friction * normal_n / (drive.a + drive.b)


def sliding_min_m_s(drive: Drive, friction: float, normal_n: float) -> float:
    """References above this make a wheel slide under a parcel at rest (eqs 15 and 16).

    Eq (16) lost the divisor k + 1 in print; here it is in `normal_n`.
    """
    return friction * normal_n / drive.a


def rolling_equilibrium_max_m_s(drive: Drive, friction: float, normal_n: float) -> float:
    """References below this make every wheel roll under a parcel at rest (eq 17)."""
    return friction * normal_n / drive.a
