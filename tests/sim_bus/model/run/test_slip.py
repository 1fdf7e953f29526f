"""Slip is the wheel's surface speed over what lies on it."""

from dataclasses import replace

import numpy as np
import pytest

from mdms_model.array import build_wheels
from mdms_model.run.derived import slip_m_s
from mdms_model.run.record import Contact, Record
from mdms_model.scenario.file import load_scenario
from mdms_sim.physics.plane.ideal import solve_ideal


def resting(scenario, twists, speed_m_s, contact=Contact.SLIDING_FORWARD):
    """One instant with all wheels at one speed and the parcels at given twists."""
    wheels = (1, len(build_wheels(scenario).cell))
    zero = np.zeros(wheels)
    return Record(
        time_s=np.zeros(1),
        pose=np.array([[(p.x_m, p.y_m, p.yaw_rad) for p in scenario.parcel]]),
        twist=np.array([twists], dtype=float),
        reference_m_s=zero,
        speed_m_s=np.full(wheels, speed_m_s),
        voltage_v=zero,
        normal_n=zero,
        force_n=zero,
        contact=np.full(wheels, contact, dtype=np.int8),
    )


@pytest.fixture
def plane():
    return load_scenario("array18")


def test_wheel_ahead_of_a_parcel_slips_forward(plane):
    slips = slip_m_s(plane, resting(plane, [(0.1, 0.0, 0.0)], speed_m_s=0.3))
    np.testing.assert_allclose(slips[0, 0::2], 0.2)
    np.testing.assert_allclose(slips[0, 1::2], 0.3)


def test_turning_parcel_runs_past_the_wheels_by_their_arms(plane):
    slips = slip_m_s(plane, resting(plane, [(0.0, 0.0, 0.5)], speed_m_s=0.0))
    arm_m = build_wheels(plane).position_m - (plane.parcel[0].x_m, plane.parcel[0].y_m)
    np.testing.assert_allclose(slips[0, 0::2], 0.5 * arm_m[0::2, 1])
    np.testing.assert_allclose(slips[0, 1::2], -0.5 * arm_m[1::2, 0])


def test_wheel_without_contact_does_not_slip(plane):
    slips = slip_m_s(plane, resting(plane, [(0.1, 0.0, 0.0)], 0.3, Contact.NONE))
    assert (slips == 0.0).all()


def test_each_wheel_slips_under_its_own_parcel(plane):
    box = replace(plane.parcel[0], length_m=0.25, width_m=0.3, goal=None)
    pair = (replace(box, name="left", x_m=-0.2), replace(box, name="right", x_m=0.2))
    two = replace(plane, parcel=pair)
    slips = slip_m_s(two, resting(two, [(0.1, 0, 0), (-0.1, 0, 0)], speed_m_s=0.0))[0, 0::2]
    left = build_wheels(two).position_m[0::2, 0] < 0
    np.testing.assert_allclose(slips[left], -0.1)
    np.testing.assert_allclose(slips[~left], 0.1)


def test_slip_agrees_with_the_contact_of_a_run():
    scenario = load_scenario("paper-fig9", ["run.fidelity=ideal", "run.duration_s=3"])
    reference_m_s = -0.75 * np.sign(build_wheels(scenario).position_m[:, 0])
    record = solve_ideal(scenario, reference_m_s)
    slips = slip_m_s(scenario, record)
    assert (slips[record.contact == Contact.SLIDING_FORWARD] > 0).all()
    assert (slips[record.contact == Contact.SLIDING_BACKWARD] < 0).all()
    np.testing.assert_allclose(slips[record.contact == Contact.ROLLING], 0, atol=1e-12)
