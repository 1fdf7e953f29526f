"""Quantities derived from a record: slip of wheels, and errors of beliefs."""

from dataclasses import replace

import numpy as np
import pytest

from mdms_model.array import build_wheels
from mdms_model.run.derived import (
    belief_error,
    cell_counts,
    host_error,
    lifted_s,
    shared_belief,
    slip_m_s,
)
from mdms_model.run.record import Contact, Event, Record
from mdms_model.scenario.file import load_scenario
from mdms_protocol.neighbours import frames as wire
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


def test_cells_under_a_parcel_are_averaged_and_no_others(held_record):
    believed = shared_belief(held_record, 0)
    np.testing.assert_allclose(believed[5:], held_record.pose[5:, 0] + [0.002, 0.0, 0.01])
    assert np.isnan(believed[:5]).all()


def test_another_parcel_is_none_of_theirs(held_record):
    assert np.isnan(shared_belief(held_record, 1)).all()


def test_cell_without_a_pose_does_not_count(held_record):
    held_record.belief[10, 7] = np.nan
    np.testing.assert_allclose(
        shared_belief(held_record, 0)[10, 0], held_record.pose[10, 0, 0] + 0.003
    )


def test_error_is_a_distance_and_the_smaller_turn(plane, held_record):
    held_record.belief[..., 2] += 2 * np.pi
    away_m, turn_rad = belief_error(held_record, 0, plane.parcel[0])[5:].T
    np.testing.assert_allclose(away_m, 0.002)
    np.testing.assert_allclose(turn_rad, 0.01)


def test_believed_yaws_on_both_sides_of_half_a_turn_have_theirs_in_between(plane, held_record):
    held_record.pose[:, 0, 2] = np.pi
    held_record.belief[5:, 7, 2] = np.pi - 0.1
    held_record.belief[5:, 8, 2] = -np.pi + 0.1
    np.testing.assert_allclose(belief_error(held_record, 0, plane.parcel[0])[5:, 1], 0.0, atol=1e-9)


def test_turn_of_a_disc_is_not_counted(plane, held_record):
    disc = replace(plane.parcel[0], shape="disc", length_m=0.3, width_m=0.3)
    away_m, turn_rad = belief_error(held_record, 0, disc)[5:].T
    np.testing.assert_allclose(away_m, 0.002)
    assert np.isnan(turn_rad).all()


def test_cells_are_counted_by_their_relation_to_parcels(held_record):
    last = {state: count[-1] for state, count in cell_counts(held_record).items()}
    assert last == {wire.UNDER: 2, wire.PROMISED: 1, wire.NEAR: 1}


def test_run_without_a_layer_has_no_belief(plane_record):
    assert np.isnan(shared_belief(plane_record, 0)).all()
    assert cell_counts(plane_record) == {}


def test_host_takes_parcels_of_one_kind_for_each_other(plane, plane_record):
    box = plane.parcel[0]
    pair = replace(
        plane, parcel=(replace(box, kind="small"), replace(box, name="other", kind="small"))
    )
    pose = np.concatenate((plane_record.pose, plane_record.pose + np.array([0.5, 0, 0])), axis=1)
    swapped = replace(plane_record, pose=pose, estimate=pose[:, ::-1] + [0.001, 0.0, 0.01])
    np.testing.assert_allclose(host_error(pair, swapped, 0), np.tile((0.001, 0.01), (41, 1)))
    others = replace(pair, parcel=tuple(replace(each, kind="") for each in pair.parcel))
    np.testing.assert_allclose(host_error(others, swapped, 0)[:, 0], 0.501)


@pytest.mark.parametrize(
    ("events", "since_s"),
    [
        ((), None),
        (((1.0, "lift begins", "box"),), 1.0),
        (((1.0, "lift begins", "box"), (2.0, "lift ends: set down at x 0.0000 m", "box")), None),
        (
            (
                (1.0, "lift begins", "box"),
                (1.5, "lift begins", "box"),
                (2.0, "lift ends: it is still held", "box"),
            ),
            1.0,
        ),
        (((1.0, "lift begins", "other"),), None),
        (
            ((1.0, "lift begins", "box"), (2.0, "lift ends", "box"), (3.0, "lift begins", "box")),
            3.0,
        ),
    ],
)
def test_parcel_is_off_the_table_since_a_hand_has_lifted_it(plane, events, since_s):
    noted = [Event(time_s, "fault", text, parcel=name) for time_s, text, name in events]
    record = replace(resting(plane, [(0.0, 0.0, 0.0)], 0.0), events=noted)
    assert lifted_s(record, "box") == since_s
