import pytest

from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Array, Cell, Scenario
from mdms_sim.physics.plane.records import build_scene


def test_records_carry_the_drive_of_the_paper_and_the_inertia_at_the_rim():
    cell = Cell(rotor_inertia_kg_m2=2e-6, wheel_inertia_kg_m2=1e-5, current_limit_a=1.5)
    record = build_scene(Scenario("wheels", Array(6, 3), cell)).model.wheels[0]
    drive = drive_of(cell)
    assert (record["a"], record["b"]) == (drive.a, drive.b)
    assert record["loss"] == pytest.approx(drive.b - drive.a)
    assert record["force_limit_n"] == pytest.approx(1.5 * drive.ke)
    assert record["mass_kg"] == pytest.approx((9 * 2e-6 + 1e-5) / 0.0254**2)
