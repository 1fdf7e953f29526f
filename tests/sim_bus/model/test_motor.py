"""The motor as the paper lumps it (section 3.2, eqs 7 to 9)."""

import pytest

from mdms_model.motor import drive_of, rim_mass_kg
from mdms_model.scenario.scenario import Cell


@pytest.mark.parametrize(("resistance_ohm", "a", "b"), [(4.0, 7.087, 9.144), (5.0, 5.669, 7.325)])
def test_droop_is_a_over_b_of_the_paper(resistance_ohm, a, b):
    drive = drive_of(Cell(resistance_ohm=resistance_ohm))
    assert (drive.a, drive.b) == pytest.approx((a, b), abs=2e-3)
    assert drive.droop == pytest.approx(a / b, abs=1e-4)


def test_the_rim_feels_the_rotor_through_the_gear_and_the_wheel_about_its_axle():
    cell = Cell(rotor_inertia_kg_m2=2e-6, wheel_inertia_kg_m2=1e-5)
    assert rim_mass_kg(cell) == pytest.approx((9 * 2e-6 + 1e-5) / 0.0254**2)
