import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.scenario.scenario import Array, Cell, Parcel, Run, Scenario, Wheel
from mdms_sim.physics.plane.world import World

PAIR = (Wheel(0.0), Wheel(1.5))
BOX = Parcel("box", 2.0, 0.36, 0.30)
MOTOR = {"rotor_inertia_kg_m2": 1e-6, "wheel_inertia_kg_m2": 1e-5}


def two_worlds(wheel):
    run = Run("firmware")
    scenario = Scenario("cells", Array(4, 3), Cell(wheel=wheel, **MOTOR), (BOX,), run=run)
    return World(scenario), World(scenario)


@pytest.mark.parametrize("wheel", [PAIR[:1], PAIR], ids=["one wheel", "two wheels"])
@given(held_uv=st.lists(st.integers(-24_000_000, 24_000_000), min_size=1, max_size=24))
def test_cells_move_the_world_as_their_voltages_do_and_sample_its_readings(wheel, held_uv):
    world, plain = two_worlds(wheel)
    axes = len(wheel)
    voltage_uv = np.resize(np.array(held_uv, np.int32), (12, 2))
    for _ in range(5):
        world.step_cells(voltage_uv, 1e-3)
        plain.step_voltage(voltage_uv[:, :axes].ravel() / 1e6, 1e-3)
    assert world.pose.tolist() == plain.pose.tolist()
    assert world.wheel_speed_m_s.tolist() == plain.wheel_speed_m_s.tolist()
    counts_per_m, counts, current_ma = world.sampled
    passed = np.floor(plain.wheel_travel_m * counts_per_m)
    assert counts[:, :axes].ravel().tolist() == passed.tolist()
    assert (
        current_ma[:, :axes].ravel().tolist() == (plain.motor_current_a * 1e3).astype(int).tolist()
    )
    assert not counts[:, axes:].any()
    assert not current_ma[:, axes:].any()


def test_counts_wrap_at_31_bits():
    world, _ = two_worlds(PAIR)
    counts_per_m = world.sampled.counts_per_m
    world.scene.state.wheels["travel_m"] = (2**30 + 0.5) / counts_per_m
    world.step_cells(np.zeros((12, 2), np.int32), 1e-3)
    assert (world.sampled.counts == -(2**30)).all()
