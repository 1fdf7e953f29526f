from dataclasses import replace

import numpy as np
import pytest

from mdms_model.fields import command_of
from mdms_model.run.record import Contact
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.rules import IDEAL_STEP_MOST_S
from mdms_model.scenario.scenario import Array, Cell, Parcel, Run, Scenario, Wheel
from mdms_sim.physics.plane.ideal import run_ideal, solve_ideal
from mdms_sim.physics.plane.world import World
from mdms_sim.physics.row.solver import solve_row

INWARD = -np.sign(np.arange(10) - 4.5)


def paper(figure, step_s, duration_s=20.0):
    scenario = load_scenario(f"paper-fig{figure}")
    run = replace(scenario.run, fidelity="ideal", step_s=step_s, duration_s=duration_s)
    return replace(scenario, run=run)


def middle_m(record):
    return record.pose[:, 0, 0]


def test_figure_7_rolls_to_rest_where_the_exact_solution_does():
    record = solve_ideal(paper(7, 1e-3), 0.0635 * INWARD)
    assert middle_m(record)[-1] == pytest.approx(-0.0308531, abs=2e-6)
    assert not record.pose[:, 0, 1:].any()
    assert (record.contact[:, 1:4] != Contact.SLIDING_FORWARD).all()


def test_figure_9_shows_the_peaks_of_the_exact_solution():
    x = middle_m(solve_ideal(paper(9, 1e-4), 0.75 * INWARD))
    turns = (x[1:-1] - x[:-2]) * (x[2:] - x[1:-1]) <= 0
    peaks = x[1:-1][turns][:4]
    assert peaks == pytest.approx([0.1134, -0.1042, 0.0997, -0.0965], abs=2e-4)


@pytest.mark.parametrize(("figure", "speed", "bound_m"), [(7, 0.0635, 5e-6), (8, 10.0, 1e-4)])
def test_one_row_of_one_wheel_cells_tends_to_the_exact_row(figure, speed, bound_m):
    """Where supports change, a step errs by its share of the change: the first order remains."""
    exact = solve_row(paper(figure, 1e-2, 5.0), speed * INWARD)
    errors = []
    for step_s in (5e-3, 5e-5):
        record = solve_ideal(paper(figure, step_s, 5.0), speed * INWARD)
        x = np.interp(record.time_s, exact.time_s, middle_m(exact))
        errors.append(np.abs(x - middle_m(record)).max())
    assert errors[0] / errors[1] > 15.0
    assert errors[1] < bound_m


def test_a_record_tells_of_one_instant_in_each_row():
    record = solve_ideal(paper(9, 1e-3, 2.0), 0.75 * INWARD)
    assert record.time_s == pytest.approx(np.arange(201) * 0.01)
    carried = record.normal_n.sum(axis=1)
    assert carried == pytest.approx(np.full(201, 2.0 * 9.81))
    rolls = record.contact == Contact.ROLLING
    speed = np.broadcast_to(record.twist[:, :, 0], record.speed_m_s.shape)
    assert rolls.any()
    assert record.speed_m_s[rolls] == pytest.approx(speed[rolls], abs=1e-12)
    slides = record.contact > Contact.ROLLING
    assert record.slip_m_s[slides] == pytest.approx((record.speed_m_s - speed)[slides])
    assert record.voltage_v == pytest.approx(10.0 * (record.reference_m_s - record.speed_m_s))


def test_a_run_in_one_kernel_is_the_run_step_by_step():
    wheel = (Wheel(0.0, (-0.03, 0.0)), Wheel(np.pi / 2, (0.03, 0.0)))
    parcels = (Parcel("a", 2.0, 0.36, 0.3, x_m=-0.25), Parcel("b", 1.0, 0.2, 0.3, x_m=0.15))
    scenario = Scenario("two", Array(8, 4), Cell(wheel=wheel), parcels, run=Run("ideal"))
    whole, stepped = World(scenario), World(scenario)
    reference = np.where(whole.wheels.direction[:, 0] > 0.5, 0.2, 0.02)
    reference[whole.wheels.position_m[:, 0] > 0.1] *= -1
    record = run_ideal(whole, reference, 1e-3, 800, 10)
    for _ in range(800):
        stepped.step_ideal(reference, 1e-3)
    assert whole.pose.tolist() == stepped.pose.tolist() == record.pose[-1].tolist()
    kinds = [(event.kind, event.detail) for event in stepped.events]
    assert [(event.kind, event.detail) for event in record.events] == kinds
    assert kinds[0][0] == "touch"


def test_a_run_ends_where_a_parcel_tips():
    scenario = replace(paper(7, 1e-3), parcel=(Parcel("box", 2.0, 0.4445, 0.1, x_m=0.3),))
    record = solve_ideal(scenario, np.full(10, 0.5))
    assert record.events[-1].kind == "tip"
    assert record.time_s[-1] <= record.events[-1].time_s < 20.0
    assert len(record.pose) == len(record.time_s) == len(record.contact)


def test_a_run_whose_parcel_tips_at_the_start_has_that_instant_alone():
    scenario = replace(paper(7, 1e-3), parcel=(Parcel("box", 2.0, 0.2, 0.1, x_m=0.63),))
    record = solve_ideal(scenario, np.full(10, -0.5))
    assert [event.kind for event in record.events] == ["tip"]
    assert record.time_s.tolist() == [0.0]
    assert record.pose[:, 0].tolist() == [[0.63, 0.0, 0.0]]


def end_of_field(step_s, *, yaw_rad=0.0):
    """Pose of the box of array18 after 2 s of the inward field, in steps of any length."""
    moved = ["motion.field='inward'", f"parcel.0.yaw_rad={yaw_rad}", "run.duration_s=2.0"]
    scenario = load_scenario("array18", moved)
    run = replace(scenario.run, fidelity="ideal", step_s=step_s)
    scenario = replace(scenario, run=run)
    return solve_ideal(scenario, command_of(scenario).set_m_s).pose[-1, 0]


def steps_differ(step_s, **box):
    """How far the end lies from that with a tenth of the step [mm; degrees]."""
    off = end_of_field(step_s, **box) - end_of_field(step_s / 10, **box)
    return 1e3 * np.hypot(off[0], off[1]), np.degrees(abs(off[2]))


@pytest.mark.parametrize("yaw_rad", [0.0, 0.2, 0.4])
def test_the_longest_step_that_is_allowed_ends_near_a_tenth_of_it(yaw_rad):
    off_mm, off_deg = steps_differ(IDEAL_STEP_MOST_S, yaw_rad=yaw_rad)
    assert off_mm < 1.2
    assert off_deg < 0.4


def test_a_step_far_beyond_it_ends_elsewhere():
    assert steps_differ(0.5)[0] > 40.0
