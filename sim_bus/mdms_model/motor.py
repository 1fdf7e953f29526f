"""The driven wheel as the parcel feels it: a force that falls linearly with speed (eqs 7 to 9)."""

from dataclasses import dataclass

from mdms_model.scenario.scenario import Cell


@dataclass(frozen=True, slots=True)
class Drive:
    """A motor, its gear and its proportional law, seen at the wheel's rim.

    A rolling wheel pushes with `a` r - `b` v, r its reference and v its surface speed [m/s]; `a`,
    `b` and the effective damping `be` are in N s/m, the effective motor constant `ke` in V s/m.
    """

    ke: float
    """Effective motor constant Ke = Km Ng / rw [N/A, V s/m]."""
    be: float
    """Effective damping Be = Bm Ng^2 / rw^2 [N s/m]."""
    a: float
    """Force per reference speed, G Ke / Rm [N s/m]."""
    b: float
    """Force lost per surface speed, Be + Ke^2/Rm + G Ke/Rm [N s/m]."""

    @property
    def droop(self) -> float:
        """Speed of a free wheel over its reference, a/b: the law is proportional only."""
        return self.a / self.b


def drive_of(cell: Cell) -> Drive:
    """Lump the constants of a cell's motor as the paper does (section 3.2, eqs 8 and 9)."""
    gear_per_m = cell.gear_ratio / cell.wheel_radius_m
    ke = cell.torque_constant_nm_per_a * gear_per_m
    be = cell.damping_nms * gear_per_m**2
    a = cell.gain_vs_per_m * ke / cell.resistance_ohm
    return Drive(ke=ke, be=be, a=a, b=be + ke**2 / cell.resistance_ohm + a)


def rim_mass_kg(cell: Cell) -> float:
    """Inertia of rotor and wheel, felt at the wheel's rim."""
    gear_per_m = cell.gear_ratio / cell.wheel_radius_m
    wheel_kg = cell.wheel_inertia_kg_m2 / cell.wheel_radius_m**2
    return cell.rotor_inertia_kg_m2 * gear_per_m**2 + wheel_kg
