"""The effect of the bridges of a cell on its motors: driven, shorted or open."""

import numpy as np
import pytest

from mdms_model.scenario.file import load_scenario
from mdms_sim.physics.plane.world import World

DRIVEN = np.full((18, 2), 6_000_000, np.int32)
ZERO = np.zeros((18, 2), np.int32)


def moving_world() -> World:
    """The demo's box at 0.2 m/s or so, carried by driven wheels."""
    world = World(load_scenario("array18", ["parcel.0.x_m=0", "parcel.0.y_m=0"]))
    for _ in range(400):
        world.step_cells(DRIVEN * np.array([1, 0], np.int32), 1e-3)
    assert world.twist[0, 0] > 0.2
    return world


def way_m(world: World, steps: int = 600) -> float:
    """How far the box goes on at 0 V."""
    start_m = world.pose[0, 0]
    for _ in range(steps):
        world.step_cells(ZERO, 1e-3)
    return float(world.pose[0, 0] - start_m)


def test_a_shorted_motor_brakes_and_an_open_one_coasts() -> None:
    braked, asleep = moving_world(), moving_world()
    asleep.bridges.awake[:] = 0
    braked_m = way_m(braked)
    assert np.abs(braked.twist[0]).max() < 0.06
    assert way_m(asleep) > 1.8 * braked_m
    assert asleep.twist[0, 0] > 0.3


@pytest.mark.parametrize("cause", ["supply", "fault"])
def test_without_a_supply_or_after_a_fault_of_its_own_a_bridge_neither_drives_nor_brakes(
    cause: str,
) -> None:
    world, asleep = moving_world(), moving_world()
    asleep.bridges.awake[:] = 0
    if cause == "supply":
        world.bridges.supply_v[:] = 0.0
    else:
        world.bridges.shut_off[:] = 1
    for _ in range(100):
        world.step_cells(DRIVEN, 1e-3)
        asleep.step_cells(ZERO, 1e-3)
        assert (world.motor_current_a == 0.0).all()
    assert world.pose == pytest.approx(asleep.pose, abs=1e-12)
    read_ma = world.sampled.current_ma
    assert (read_ma == (0 if cause == "supply" else 2_000_000)).all()


@pytest.mark.parametrize("cause", ["no supply", "asleep", "driven", "reversed"])
def test_contacts_of_an_emergency_stop_brake_whatever_the_bridge_does(cause: str) -> None:
    world, braked = moving_world(), moving_world()
    world.bridges.shorted[:] = 1
    wanted = DRIVEN if cause == "driven" else ZERO
    if cause == "no supply":
        world.bridges.supply_v[:] = 0.0
    elif cause == "asleep":
        world.bridges.awake[:] = 0
    elif cause == "reversed":
        world.scene.state.wheels["reversed"] = 1
    for _ in range(600):
        world.step_cells(wanted, 1e-3)
        braked.step_cells(ZERO, 1e-3)
        # The current in the short does not pass the bridge, which measures nothing.
        assert not world.sampled.current_ma.any()
    assert world.pose == pytest.approx(braked.pose, abs=1e-12)
    assert np.abs(world.twist[0]).max() < 0.06


@pytest.mark.parametrize(("mass_kg", "speed_m_s", "went_m"), [(2, 0.0, 0.103), (10, 0.034, 0.267)])
def test_from_0_4_m_s_a_shorted_motor_brakes_as_the_design_has_it(
    mass_kg: float, speed_m_s: float, went_m: float
) -> None:
    """The speed that is left after the 2 s for which a cell brakes at most."""
    overrides = ["parcel.0.x_m=0", "parcel.0.y_m=0", f"parcel.0.mass_kg={mass_kg}"]
    world = World(load_scenario("array18", overrides))
    while world.twist[0, 0] < 0.4:
        world.step_cells(DRIVEN * np.array([1, 0], np.int32), 1e-3)
    assert way_m(world, 2000) == pytest.approx(went_m, abs=0.002)
    assert world.twist[0, 0] == pytest.approx(speed_m_s, abs=0.001)
