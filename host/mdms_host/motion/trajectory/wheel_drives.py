"""The drives of all wheels: which reference makes a wheel push as it is to (eqs 7 to 9)."""

from dataclasses import dataclass
from math import inf

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.motor import drive_of, rim_mass_kg
from mdms_model.scenario.scenario import Cell

#: This share of the supply is planned with; the rest is for feedback, and for supplies that sag.
_SUPPLY_SHARE = 0.85


@dataclass(frozen=True, slots=True)
class WheelDrives:
    """A rolling wheel pushes with a r - b u - m u', r its reference, u its surface speed [m/s].

    `a` and `b` are of shape (W,) [N s/m], for gains may differ; m is the inertia of rotor and wheel
    at the rim. The motor gives at most `stall_n` - `slope` u, and no more than `most_n`.
    """

    a_n_s_per_m: Floats
    b_n_s_per_m: Floats
    rim_mass_kg: float
    stall_n: float
    slope_n_s_per_m: float
    most_n: float = inf
    reference_limit_m_s: float = inf

    def references_m_s(self, speed_m_s: Floats, rate_m_s2: Floats, push_n: Floats) -> Floats:
        """References at which wheels of these speeds push so and speed up so, all (W,).

        A wheel without gain follows no reference: 0. References are held within the range of the
        wire.
        """
        force_n = self.b_n_s_per_m * speed_m_s + self.rim_mass_kg * rate_m_s2 + push_n
        driven = self.a_n_s_per_m > 0.0
        references_m_s = np.divide(
            force_n, self.a_n_s_per_m, out=np.zeros_like(force_n), where=driven
        )
        limit_m_s = self.reference_limit_m_s
        return np.clip(references_m_s, -limit_m_s, limit_m_s)

    def motor_limit_n(self, speed_m_s: Floats) -> Floats:
        """Largest force of motor, bridge and wire at a given wheel speed, either way [N]."""
        motor_n = np.minimum(self.stall_n - self.slope_n_s_per_m * speed_m_s, self.most_n)
        if self.reference_limit_m_s < inf:
            wire_n = self.a_n_s_per_m.max() * self.reference_limit_m_s
            motor_n = np.minimum(motor_n, wire_n - self.b_n_s_per_m.max() * speed_m_s)
        limit_n: Floats = motor_n
        return limit_n


def wheel_drives_of(
    cell: Cell, gains_vs_per_m: Floats, reference_limit_m_s: float = inf
) -> WheelDrives:
    """The drives of wheels whose motors are those of a cell, and whose gains are these, (W,)."""
    drive = drive_of(cell)
    ke_per_ohm = drive.ke / cell.resistance_ohm
    slope = drive.b - drive.a
    current_a = cell.current_limit_a
    return WheelDrives(
        a_n_s_per_m=gains_vs_per_m * ke_per_ohm,
        b_n_s_per_m=slope + gains_vs_per_m * ke_per_ohm,
        rim_mass_kg=rim_mass_kg(cell),
        stall_n=_SUPPLY_SHARE * cell.supply_v * ke_per_ohm,
        slope_n_s_per_m=slope,
        most_n=inf if current_a is None else _SUPPLY_SHARE * current_a * drive.ke,
        reference_limit_m_s=reference_limit_m_s,
    )
