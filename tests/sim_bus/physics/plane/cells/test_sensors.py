from dataclasses import replace

import numpy as np
import pytest
from tests.sim_bus.physics.tables import BOX, plane

from mdms_model.scenario.scenario import Cell, Parcel, Run
from mdms_sim.physics.plane.control_step import LoadCells, counts_per_m, encoder_count
from mdms_sim.physics.plane.world import World

REST = np.zeros(36)


def scenario(parcel=None, **cell):
    return plane(parcel or replace(BOX, x_m=-0.1), **cell)


def test_a_wheel_counts_as_the_reference_says():
    # reference: 26.6 um per count at 63.5 mm/s and 1 kHz
    assert 1e6 / counts_per_m(Cell()) == pytest.approx(26.6, abs=0.05)


def test_counts_wrap_like_small_integers():
    travels_m = (0.0, 2.0**30 - 0.5, 2.0**30 + 0.5, -0.5, -(2.0**30) - 1)
    counts = [encoder_count(travel_m, 1.0) for travel_m in travels_m]
    assert counts == [0, 2**30 - 1, -(2**30), -1, 2**30 - 1]


def test_presence_bits_are_the_sensors_under_the_parcel():
    turned = Parcel("box", 2.0, 0.36, 0.30, x_m=-0.1, y_m=0.02, yaw_rad=0.4)
    world = World(scenario(turned))
    bits = world.presence()
    for cell, (x, y) in enumerate(np.array([(i % 6, i // 6) for i in range(18)]) - [2.5, 1.0]):
        for s, (ahead, aside) in enumerate(Cell().sensor_offset_m):
            at = np.array([x * 0.127 + ahead + 0.1, y * 0.127 + aside - 0.02])
            own = at @ [[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]]
            covered = abs(own[0]) <= 0.18 and abs(own[1]) <= 0.15
            assert bool(bits[cell] >> s & 1) == covered


def test_presence_comes_late_by_the_delay():
    prompt, late = World(scenario()), World(scenario(sensor_delay_s=0.005))
    drive = np.tile([10.0, 0.0], 18)
    seen = []
    for _ in range(400):
        prompt.step_voltage(drive, 1e-3)
        late.step_voltage(drive, 1e-3)
        seen.append(prompt.presence().tolist())
        told = late.presence().tolist()
        assert told == seen[max(len(seen) - 6, 0)]
    assert seen[0] != seen[-1]


def test_noise_flips_its_share_of_bits_by_the_seed():
    noisy = scenario(sensor_noise=0.1)
    still = World(scenario()).presence()
    worlds = [World(noisy), World(noisy), World(replace(noisy, run=Run(seed=2)))]
    readings = [np.array([world.presence() for _ in range(200)]) for world in worlds]
    flips = np.unpackbits(readings[0] ^ still, axis=1).sum()
    assert flips / (200 * 18 * 5) == pytest.approx(0.1, abs=0.01)
    assert (readings[0] == readings[1]).all()
    assert (readings[0] != readings[2]).any()


def test_load_cells_tell_normal_forces_with_their_noise():
    world = World(scenario(load_cell_noise_n=0.05))
    world.step_voltage(REST, 1e-3)
    errors = np.array([world.load_n() for _ in range(200)]) - world.normal_n
    assert errors.std() == pytest.approx(0.05, rel=0.05)
    assert world.normal_n.sum() == pytest.approx(2.0 * 9.81)


def test_an_array_without_load_cells_tells_no_load():
    assert World(scenario()).load_n() is None
    assert LoadCells(scenario(), 0.0).read(REST).tolist() == REST.tolist()
