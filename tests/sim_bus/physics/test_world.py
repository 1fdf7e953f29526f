"""Laws and closed forms of parcels in the plane."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdms_sim.physics.drive import drive_of
from mdms_sim.physics.world import World
from mdms_sim.record import Contact
from mdms_sim.scenario import Array, Cell, Parcel, Patch, Run, Scenario, Wheel

G_M_S2 = 9.81
PAIR = (Wheel(0.0, (-0.03, 0.0)), Wheel(np.pi / 2, (0.03, 0.0)))
TOGETHER = (Wheel(0.0), Wheel(np.pi / 2))
OMNI = tuple(
    Wheel(angle, (0.03 * np.cos(angle), 0.03 * np.sin(angle))) for angle in (0.1, 2.2, 4.3)
)
BOX = Parcel("box", 2.0, 0.36, 0.30)


def plane(*parcels, wheel=PAIR, columns=6, rows=3, **cell):
    return Scenario(
        "plane",
        Array(columns, rows),
        Cell(wheel=wheel, **cell),
        parcels or (BOX,),
        run=Run("ideal"),
    )


def rigid_speed(world, twist, about=(0.0, 0.0)):
    """Speed of a rigid field along every wheel, J xi."""
    arm = world.wheels.position_m - about
    field = np.column_stack([twist[0] - twist[2] * arm[:, 1], twist[1] + twist[2] * arm[:, 0]])
    return (field * world.wheels.direction).sum(axis=1)


def set_twist(world, twist):
    body = world.scene.parcels[0]
    body["vx_m_s"], body["vy_m_s"], body["yaw_rate_rad_s"] = twist


def kinetic_j(world):
    bodies = world.scene.parcels
    speed2 = bodies["vx_m_s"] ** 2 + bodies["vy_m_s"] ** 2
    turning = bodies["inertia_kg_m2"] * bodies["yaw_rate_rad_s"] ** 2
    return 0.5 * (bodies["mass_kg"] * speed2 + turning).sum()


# Closed forms ------------------------------------------------------------------------------------


def test_a_parcel_at_rest_on_still_wheels_stays():
    world = World(plane(replace(BOX, x_m=0.05, yaw_rad=0.3)))
    for _ in range(100):
        world.step_ideal(np.zeros(36), 1e-3)
        world.step_voltage(np.zeros(36), 1e-3)
    assert world.pose.tolist() == [[0.05, 0.0, 0.3]]
    assert not world.twist.any()


def test_a_uniform_field_that_slips_accelerates_by_mu_g():
    world = World(plane(wheel=(Wheel(0.0),), rows=3))
    for _ in range(100):
        world.step_ideal(np.full(18, 10.0), 1e-3)
    assert world.twist[0] == pytest.approx([0.3 * G_M_S2 * 0.1, 0.0, 0.0], abs=1e-12)
    assert world.pose[0, 0] == pytest.approx(0.5 * 0.3 * G_M_S2 * 0.1**2, rel=1e-12)


def test_half_of_the_wheels_pull_along_x_in_an_array_of_pairs():
    world = World(plane(wheel=TOGETHER))
    fast = np.where(world.wheels.direction[:, 0] > 0.5, 10.0, 0.0)
    for _ in range(50):
        world.step_ideal(fast, 1e-3)
    assert world.twist[0] == pytest.approx([0.3 * G_M_S2 * 0.05 / 2, 0.0, 0.0], abs=1e-12)


def test_a_uniform_field_that_rolls_approaches_its_speed_exponentially():
    scenario = plane(replace(BOX, length_m=0.4), wheel=(Wheel(0.0),))
    drive = drive_of(scenario.cell)
    end = drive.droop * 0.01
    errors = []
    for steps in (10, 20, 40):
        world = World(scenario)
        for _ in range(steps):
            world.step_ideal(np.full(18, 0.01), 0.02 / steps)
        supports = (world.normal_n > 0).sum()
        rate = supports * drive.b / BOX.mass_kg
        errors.append(abs(world.twist[0, 0] - end * (1 - np.exp(-rate * 0.02))))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)
    assert errors[2] < 1e-4 * end


@pytest.mark.parametrize("wheel", [PAIR, TOGETHER, OMNI], ids=["pair", "together", "omni"])
def test_a_rigid_field_pushes_nothing_that_moves_with_it(wheel):
    world = World(plane(replace(BOX, x_m=0.04, y_m=-0.02, yaw_rad=0.5), wheel=wheel))
    drive, twist = drive_of(world.scenario.cell), (0.05, -0.03, 0.4)
    set_twist(world, twist)
    about = world.pose[0, :2] + 0.5e-3 * world.twist[0, :2]
    world.step_ideal(rigid_speed(world, twist, about) / drive.droop, 1e-3)
    assert world.twist[0] == pytest.approx(twist, rel=1e-13)
    assert world.force_n == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("twist", "drift"),
    [((0.02, -0.01, 0.0), 1e-10), ((0.0, 0.0, 0.3), 1e-4)],
    ids=["straight", "turning"],
)
@pytest.mark.parametrize("wheel", [PAIR, TOGETHER, OMNI], ids=["pair", "together", "omni"])
def test_a_parcel_takes_up_the_rigid_twist_it_is_driven_with(wheel, twist, drift):
    """Spinning up moves the middle off the field's centre a little, about which it then drifts."""
    world = World(plane(wheel=wheel))
    reference = rigid_speed(world, twist) / drive_of(world.scenario.cell).droop
    for _ in range(2000):
        world.step_ideal(reference, 1e-3)
    assert world.twist[0] == pytest.approx(twist, abs=drift)


def test_free_wheels_droop_by_a_over_b():
    fine = {"rotor_inertia_kg_m2": 2e-6, "pwm_steps": 10**6}
    world = World(plane(replace(BOX, x_m=-0.2, length_m=0.2), **fine))
    reference, gain = np.full(36, 0.1), world.scenario.cell.gain_vs_per_m
    free = world.wheels.position_m[:, 0] > 0.1
    droop = drive_of(world.scenario.cell).droop
    world.step_ideal(np.zeros(36), 1e-3)
    world.step_ideal(reference, 1e-3)
    assert world.wheel_speed_m_s[free] == pytest.approx(0.1 * droop)
    for _ in range(300):
        world.step_voltage(gain * (reference - world.wheel_speed_m_s), 1e-3)
    assert world.wheel_speed_m_s[free] == pytest.approx(0.1 * droop, rel=1e-4)


def test_a_disc_on_still_wheels_spins_down_evenly_and_then_exponentially():
    disc = Parcel("disc", 2.0, 0.3, 0.3, shape="disc")
    scenario = plane(disc, wheel=TOGETHER, columns=2, rows=2)
    world, lever = World(scenario), 0.127 / 2
    inertia = 2.0 * 0.15**2 / 2
    slowing = 0.3 * 2.0 * G_M_S2 * lever / inertia
    limit = 0.3 * 2.0 * G_M_S2 / 8 / drive_of(scenario.cell).b / lever  # b u = mu N
    set_twist(world, (0.0, 0.0, 10.0))
    for _ in range(40):
        world.step_ideal(np.zeros(8), 1e-3)
    assert world.twist[0] == pytest.approx([0.0, 0.0, 10.0 - slowing * 0.04], abs=1e-12)
    slides_s = (10.0 - limit) / slowing
    for _ in range(2000):
        world.step_ideal(np.zeros(8), (slides_s + 0.01 - 0.04) / 2000)
    rolling = limit * np.exp(-8 * drive_of(scenario.cell).b * lever**2 / inertia * 0.01)
    assert world.twist[0, 2] == pytest.approx(rolling, rel=1e-5)


@given(
    st.floats(-0.3, 0.3),
    st.floats(-0.5, 0.5),
    st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
)
def test_viscous_sliding_in_a_linear_field_knows_no_supports(x_m, speed_m_s, line):
    parcel = replace(BOX, length_m=0.42, x_m=x_m)
    stiff = {"viscous_friction_s_per_m": 0.5, "gain_vs_per_m": 1e9}
    world = World(plane(parcel, wheel=(Wheel(0.0),), columns=10, rows=1, **stiff))
    set_twist(world, (speed_m_s, 0.0, 0.0))
    slope, offset = line
    step_s = 1e-9
    world.step_ideal(slope * world.wheels.position_m[:, 0] + offset, step_s)
    expected = 0.5 * 2.0 * G_M_S2 * (slope * x_m + offset - speed_m_s)
    assert world.force_n.sum() == pytest.approx(expected, rel=1e-6, abs=1e-6)


@given(st.integers(0, 10**6))
def test_viscous_sliding_in_a_plane_pushes_with_half_of_the_weight_each_way(seed):
    """Each of two wheels at one point carries half of the cell's load and pushes one way only."""
    chance = np.random.default_rng(seed)
    x_m, y_m, yaw_rad = chance.uniform(-0.1, 0.1, 3)
    stiff = {"viscous_friction_s_per_m": 0.5, "gain_vs_per_m": 1e9}
    world = World(plane(replace(BOX, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), wheel=TOGETHER, **stiff))
    matrix, offset, twist = chance.normal(size=(2, 2)), chance.normal(size=2), chance.normal(size=3)
    set_twist(world, twist)
    field = world.wheels.position_m @ matrix.T + offset
    world.step_ideal((field * world.wheels.direction).sum(axis=1), 1e-9)
    force_n = world.force_n @ world.wheels.direction
    expected = 0.5 * 2.0 * G_M_S2 / 2 * (matrix @ [x_m, y_m] + offset - twist[:2])
    assert force_n == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_rollers_with_friction_slow_a_parcel_along_the_axles():
    world = World(plane(wheel=(Wheel(0.0),), roller_friction=0.02))
    set_twist(world, (0.0, 0.1, 0.0))
    for _ in range(100):
        world.step_ideal(np.zeros(18), 1e-3)
    assert world.twist[0] == pytest.approx([0.0, 0.1 - 0.02 * G_M_S2 * 0.1, 0.0], abs=1e-12)
    for _ in range(900):
        world.step_voltage(np.zeros(18), 1e-3)
    assert world.twist[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_free_wheel_answers_to_its_voltage_as_equation_8_says():
    world = World(plane(replace(BOX, x_m=-0.2, length_m=0.2), rotor_inertia_kg_m2=2e-6))
    cell, drive = world.scenario.cell, drive_of(world.scenario.cell)
    mass_kg = 2e-6 * (3 / 0.0254) ** 2
    loss = drive.be + drive.ke**2 / cell.resistance_ohm
    for _ in range(10):
        world.step_voltage(np.full(36, 1.2), 1e-3)
    end = 1.2 * drive.ke / cell.resistance_ohm / loss
    speed = end * (1 - np.exp(-loss * 0.01 / mass_kg))
    assert world.wheel_speed_m_s[-1] == pytest.approx(speed)
    assert world.wheel_travel_m[-1] == pytest.approx(end * 0.01 - speed * mass_kg / loss)


def test_the_current_limit_holds_the_force_of_a_starting_motor():
    parcel = replace(BOX, x_m=-0.2, length_m=0.2)
    world = World(plane(parcel, rotor_inertia_kg_m2=2e-6, damping_nms=0.0, current_limit_a=0.5))
    mass_kg, ke = 2e-6 * (3 / 0.0254) ** 2, drive_of(world.scenario.cell).ke
    for _ in range(10):
        world.step_voltage(np.full(36, -24.0), 1e-3)
    assert world.wheel_speed_m_s[-1] == pytest.approx(-ke * 0.5 / mass_kg * 0.01)


def test_the_current_is_what_voltage_and_back_emf_leave_and_keeps_within_its_limit():
    parcel = replace(BOX, x_m=-0.2, length_m=0.2)
    world = World(plane(parcel, rotor_inertia_kg_m2=2e-6, current_limit_a=0.5))
    cell, drive = world.scenario.cell, drive_of(world.scenario.cell)
    for _ in range(3):
        world.step_voltage(np.full(36, -12.0), 1e-3)
    assert world.motor_current_a == pytest.approx(-0.5)
    for _ in range(50):
        world.step_voltage(np.full(36, 1.2), 1e-3)
    back_emf_v = drive.ke * world.wheel_speed_m_s
    assert world.motor_current_a == pytest.approx((1.2 - back_emf_v) / cell.resistance_ohm)


def test_voltages_beyond_the_supply_and_below_a_pwm_step_are_cut():
    low, high, zero = (World(plane(pwm_steps=100)) for _ in range(3))
    for _ in range(5):
        low.step_voltage(np.full(36, 24.0), 1e-3)
        high.step_voltage(np.full(36, 99.0), 1e-3)
        zero.step_voltage(np.full(36, 0.119), 1e-3)
    assert (low.wheel_speed_m_s == high.wheel_speed_m_s).all()
    assert not zero.wheel_speed_m_s.any()


def test_the_pose_is_that_of_the_middle_and_turns_about_the_centre_of_mass():
    parcel = replace(BOX, x_m=0.03, y_m=-0.01, yaw_rad=0.4, centre_of_mass_m=(0.05, 0.02))
    world = World(plane(parcel))
    assert world.pose[0] == pytest.approx([0.03, -0.01, 0.4])
    set_twist(world, (0.0, 0.0, 1.0))
    arm = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]]) @ [0.05, 0.02]
    assert world.twist[0] == pytest.approx([arm[1], -arm[0], 1.0])


# Laws --------------------------------------------------------------------------------------------


def wild_world(seed, **cell):
    """A parcel thrown onto wheels that run at random, some rolling and some slipping."""
    chance = np.random.default_rng(seed)
    pose = dict(zip(("x_m", "y_m", "yaw_rad"), chance.uniform(-0.1, 0.1, 3), strict=True))
    parcel = replace(BOX, **pose, centre_of_mass_m=(0.03, -0.02))
    world = World(plane(parcel, wheel=OMNI, **cell))
    set_twist(world, chance.normal(0.0, [0.1, 0.1, 0.5]))
    return world, chance.normal(0.0, 0.2, len(world.wheels.cell))


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.booleans())
def test_no_wheel_exceeds_its_friction_and_slipping_wheels_push_with_their_slip(seed, ideal):
    world, reference = wild_world(seed, rotor_inertia_kg_m2=2e-6)
    for _ in range(50):
        if ideal:
            world.step_ideal(reference, 1e-3)
        else:
            world.step_voltage(30.0 * reference, 1e-3)
        force, slip, contact = world.force_n, world.slip_m_s, world.contact
        assert (abs(force) <= 0.3 * world.normal_n + 1e-12).all()
        assert (force * slip >= -1e-12).all()
        assert not force[contact == Contact.NONE].any()
        assert (force[contact == Contact.SLIDING_FORWARD] >= 0.0).all()
        assert (force[contact == Contact.SLIDING_BACKWARD] <= 0.0).all()
        assert not slip[contact == Contact.ROLLING].any()
        assert world.normal_n.sum() == pytest.approx(2.0 * G_M_S2)


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=20)
def test_work_of_ideal_motors_is_kinetic_energy_and_dissipation(seed):
    world, reference = wild_world(seed)
    start_j, work_j, lost_j = kinetic_j(world), 0.0, 0.0
    for _ in range(100):
        world.step_ideal(reference, 1e-3)
        work_j += 1e-3 * (world.force_n * world.wheel_speed_m_s).sum()
        lost_j += 1e-3 * (world.force_n * world.slip_m_s).sum()
    assert lost_j > 0.0
    assert work_j == pytest.approx(kinetic_j(world) - start_j + lost_j, rel=1e-10, abs=1e-12)


def test_work_of_motors_with_inertia_is_kinetic_energy_and_dissipation_at_small_steps():
    """Slip's loss is taken from the parcel's own motion, so nothing here is true by definition."""
    world, reference = wild_world(3, rotor_inertia_kg_m2=2e-6, pwm_steps=10**6)
    wheels, step_s, voltage_v = world.scene.wheels, 1e-6, 20.0 * reference
    wheel_j = 0.5 * (wheels["mass_kg"] * wheels["speed_m_s"] ** 2).sum()
    start_j, work_j, lost_j = kinetic_j(world) + wheel_j, 0.0, 0.0
    for _ in range(20_000):
        travel, speed, body = world.wheel_travel_m, world.wheel_speed_m_s, world.scene.parcels[0]
        x, y, yaw = body["x_m"], body["y_m"], body["yaw_rad"]
        world.step_voltage(voltage_v, step_s)
        travel = world.wheel_travel_m - travel
        mean = (speed + world.wheel_speed_m_s) / 2
        work_j += ((wheels["drive_n"] - wheels["loss"] * mean) * travel).sum()
        moved = (body["x_m"] - x, body["y_m"] - y, body["yaw_rad"] - yaw)
        middle = (x + moved[0] / 2, y + moved[1] / 2)
        lost_j += (world.force_n * (travel - rigid_speed(world, moved, middle))).sum()
    wheel_j = 0.5 * (wheels["mass_kg"] * wheels["speed_m_s"] ** 2).sum()
    assert lost_j > 0.0
    assert work_j == pytest.approx(kinetic_j(world) + wheel_j - start_j + lost_j, rel=1e-6)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10**6), st.booleans())
def test_a_mirrored_table_gives_the_mirrored_motion(seed, ideal):
    chance = np.random.default_rng(seed)
    x_m, y_m, yaw_rad = chance.uniform(-0.1, 0.1, 3)
    inertia = {"wheel": TOGETHER, "rotor_inertia_kg_m2": 2e-6}
    world = World(plane(replace(BOX, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), **inertia))
    mirror = World(plane(replace(BOX, x_m=x_m, y_m=-y_m, yaw_rad=-yaw_rad), **inertia))
    drives = chance.normal(0.0, 0.3, (3, 6, 2))
    mirrored = drives[::-1] * [1.0, -1.0]
    for _ in range(200):
        if ideal:
            world.step_ideal(drives.ravel(), 1e-3)
            mirror.step_ideal(mirrored.ravel(), 1e-3)
        else:
            world.step_voltage(20 * drives.ravel(), 1e-3)
            mirror.step_voltage(20 * mirrored.ravel(), 1e-3)
    assert mirror.pose * [1.0, -1.0, -1.0] == pytest.approx(world.pose, abs=1e-9)


def test_a_run_repeats_to_the_last_bit():
    first, second = (wild_world(11, motor_spread=0.1, rotor_inertia_kg_m2=2e-6) for _ in range(2))
    for world, reference in (first, second):
        for _ in range(300):
            world.step_voltage(20.0 * reference, 1e-3)
    assert first[0].pose.tobytes() == second[0].pose.tobytes()
    assert first[0].wheel_travel_m.tobytes() == second[0].wheel_travel_m.tobytes()


def test_firmware_tends_to_ideal_as_tick_and_inertia_vanish():
    """The sampled proportional law on wheels with inertia, against the continuous law on none."""
    parcel, errors = replace(BOX, x_m=0.02, y_m=0.01, yaw_rad=0.2), []
    world = World(plane(parcel))
    reference = rigid_speed(world, (0.05, 0.02, 0.3))
    for _ in range(5000):
        world.step_ideal(reference, 5e-5)
    for tick_s in (1e-3, 5e-4, 2.5e-4):
        light = World(plane(parcel, rotor_inertia_kg_m2=1e-3 * tick_s, pwm_steps=10**6))
        for _ in range(round(0.25 / tick_s)):
            light.step_voltage(10.0 * (reference - light.wheel_speed_m_s), tick_s)
        errors.append(np.abs(light.pose - world.pose).max())
    assert errors[2] < 2e-4
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.2)


def test_viscous_sliding_under_voltage_tends_to_that_of_the_ideal_law():
    film, errors = {"viscous_friction_s_per_m": 0.5}, []
    world = World(plane(replace(BOX, yaw_rad=0.2), **film))
    reference = rigid_speed(world, (0.05, 0.02, 0.3))
    for _ in range(5000):
        world.step_ideal(reference, 5e-5)
    assert world.slip_m_s.any()
    for tick_s in (1e-3, 5e-4, 2.5e-4):
        fine = {"rotor_inertia_kg_m2": 1e-3 * tick_s, "pwm_steps": 10**6}
        light = World(plane(replace(BOX, yaw_rad=0.2), **film, **fine))
        for _ in range(round(0.25 / tick_s)):
            light.step_voltage(10.0 * (reference - light.wheel_speed_m_s), tick_s)
        errors.append(np.abs(light.pose - world.pose).max())
    assert errors[2] < 1e-4
    assert errors[0] / errors[2] == pytest.approx(4.0, rel=0.3)


# Events and mixtures -----------------------------------------------------------------------------


@pytest.mark.parametrize("ideal", [True, False])
def test_a_parcel_carried_over_the_edge_tips_once(ideal):
    world = World(plane(replace(BOX, x_m=0.2), wheel=(Wheel(0.0),)))
    for _ in range(3000):
        if ideal:
            world.step_ideal(np.full(18, 0.2), 1e-3)
        else:
            world.step_voltage(np.full(18, 0.5), 1e-3)
        if world.events:
            break
    (event,) = world.events
    assert (event.kind, event.parcel) == ("tip", "box")
    assert event.time_s == pytest.approx(world.time_s)
    assert world.pose[0, 0] == pytest.approx(2.5 * 0.127, abs=1e-3)
    world.step_ideal(np.full(18, 0.2), 1e-3)
    assert len(world.events) == 1


def test_cells_without_friction_in_a_mixed_array_only_carry():
    slippery = Patch(tuple(range(1, 19, 2)), friction=0.0)
    world = World(replace(plane(wheel=(Wheel(0.0),)), patch=(slippery,)))
    for _ in range(10):
        world.step_ideal(np.full(18, 5.0), 1e-3)
    assert world.normal_n[::2].any()
    assert not world.force_n[::2].any()
    assert world.twist[0, 0] == pytest.approx(
        0.3 * world.normal_n[1::2].sum() / 2.0 * 0.01, rel=0.01
    )


def test_a_parcel_rides_from_cells_of_one_kind_onto_cells_of_another():
    onward = Patch(tuple(c + 6 * r for r in range(3) for c in (4, 5, 6)), wheel=OMNI)
    world = World(replace(plane(replace(BOX, x_m=-0.15)), patch=(onward,)))
    assert len(world.wheels.cell) == 9 * 2 + 9 * 3
    reference = rigid_speed(world, (0.1, 0.0, 0.0)) / drive_of(world.scenario.cell).droop
    for _ in range(3000):
        world.step_ideal(reference, 1e-3)
    assert world.twist[0] == pytest.approx([0.1, 0.0, 0.0], abs=1e-9)
    assert world.pose[0, 0] > 0.1
