import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tests.host.motion.driving import BOX, LAYOUT, mass_of

from mdms_host.motion.trajectory.pushes import Mass, Pushes, pushes_at, uniform_mass
from mdms_model.statics.supports import press

WEIGHT_N = 2.0 * 9.81
POSES = st.lists(
    st.tuples(st.floats(-0.15, 0.15), st.floats(-0.05, 0.05), st.floats(-3, 3)),
    min_size=1,
    max_size=4,
).map(np.array)
OFF_CENTRE = Mass(2.0, 0.05, (0.05, -0.03))


def under(poses: np.ndarray, mass: Mass) -> Pushes:
    return pushes_at(LAYOUT, BOX.footprint, mass, poses, WEIGHT_N)


@settings(max_examples=30, deadline=None)
@given(POSES, st.sampled_from([mass_of(BOX), OFF_CENTRE]))
def test_wheels_carry_the_loads_of_the_simulator(poses: np.ndarray, mass: Mass) -> None:
    pushes = under(poses, mass)
    for sample, pose in enumerate(poses):
        away_m = BOX.footprint.distance_m(LAYOUT.wheel_positions_m, pose)
        supports = np.flatnonzero(away_m < 0)
        spots_m = LAYOUT.wheel_positions_m[supports] - pose[:2] - pushes.arm_m[sample]
        normal_n = np.zeros(len(supports))
        stands = press(np.ascontiguousarray(spots_m), WEIGHT_N, normal_n)
        # With its mass off the centre it tips at some places.
        assert stands or mass is OFF_CENTRE
        assume(stands)
        carried_n = np.zeros(len(LAYOUT.wheel_positions_m))
        carried_n[pushes.wheels] = pushes.normal_n[sample]
        np.testing.assert_allclose(carried_n[supports], normal_n, atol=1e-6)
        assert carried_n.sum() == pytest.approx(WEIGHT_N)


@settings(max_examples=30, deadline=None)
@given(POSES, st.tuples(*[st.floats(-1, 1)] * 3).map(np.array))
def test_the_pushes_add_up_to_the_force_on_the_parcel(
    poses: np.ndarray, acceleration: np.ndarray
) -> None:
    pushes = under(poses, OFF_CENTRE)
    force_n = pushes.normal_n * pushes.shares(pushes.wrench(acceleration))
    for sample, pose in enumerate(poses):
        centre_m = pose[:2] + pushes.arm_m[sample]
        about_centre = LAYOUT.surface_jacobian(*centre_m)[pushes.wheels]
        wrench = about_centre.T @ force_n[sample]
        np.testing.assert_allclose(wrench, pushes.wrench_at(sample, acceleration), atol=1e-6)


def test_all_wheels_that_push_straight_on_are_equally_near_to_slipping() -> None:
    pushes = under(np.zeros((1, 3)), mass_of(BOX))
    shares = pushes.shares(pushes.wrench(np.array([1.0, 0.0, 0.0])))[0]
    along_x = (LAYOUT.wheel_directions[pushes.wheels, 0] > 0.5) & (pushes.normal_n[0] > 0)
    assert shares[along_x] == pytest.approx(shares[along_x][0], rel=0.02)
    assert abs(shares[~along_x]).max() < 0.02 * shares[along_x][0]


def test_a_parcel_off_the_table_is_pushed_by_nothing() -> None:
    pushes = under(np.array([(5.0, 0.0, 0.0)]), mass_of(BOX))
    assert not pushes.shares(pushes.wrench(np.ones(3))).any()


def test_an_even_plate_has_its_centre_of_mass_in_the_middle() -> None:
    mass = uniform_mass(BOX.footprint, 2.0)
    assert mass.inertia_kg_m2 == pytest.approx(2.0 * (0.36**2 + 0.30**2) / 12)
    assert mass.centre_m == pytest.approx((0.0, 0.0))
