"""The parallel environment of PettingZoo: its tests, and neighbourhoods."""

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from mdms_array.learning import cells_env
from mdms_array.learning.cells import neighbours
from mdms_model.array import cell_centres
from mdms_model.errors import InputError
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Array

#: Of one cell: whether it is there, five sensors, two wheels.
OWN = 8


def test_pettingzoos_test_of_the_interface_passes():
    parallel_api_test(cells_env(duration_s=0.5), num_cycles=200)


def test_pettingzoos_test_of_seeds_passes():
    parallel_seed_test(cells_env, num_cycles=100)


def test_pettingzoos_test_passes_cells_with_firmware():
    parallel_api_test(cells_env(fidelity="firmware", duration_s=0.2), num_cycles=25)


def test_a_cell_has_eight_neighbours_or_less_at_an_edge():
    near = neighbours(Array(6, 3))
    np.testing.assert_array_equal(near[7], [0, 1, 2, 6, 7, 8, 12, 13, 14])
    np.testing.assert_array_equal(near[0], [18, 18, 18, 18, 0, 1, 18, 6, 7])


def test_a_cell_sees_its_neighbourhood_and_nothing_beyond():
    env = cells_env()
    seen, _ = env.reset(seed=1)
    table = env.episode.observation()
    bits, speeds = table["presence"][0].reshape(18, 5), table["wheel_speed_m_s"][0].reshape(18, 2)
    for number, near in enumerate(neighbours(Array(6, 3))):
        own = seen[f"cell_{number + 1}"]
        assert own.shape == (9 * OWN + 4,)
        for place, cell in enumerate(near):
            part = own[OWN * place : OWN * (place + 1)]
            if cell == 18:
                assert not part.any()
            else:
                np.testing.assert_array_equal(part, [1.0, *bits[cell], *speeds[cell]])


def test_actions_drive_the_wheels_of_their_own_cell():
    env = cells_env(most_m_s=0.2)
    env.reset(seed=1)
    still = dict.fromkeys(env.agents, np.zeros(2, np.float32))
    away = next(
        number
        for number, bits in enumerate(env.episode.observation()["presence"][0].reshape(18, 5))
        if not bits.any()
    )
    agent = f"cell_{away + 1}"
    env.step(still | {agent: np.array([1.0, -1.0], np.float32)})
    speeds = env.episode.observation()["wheel_speed_m_s"][0].reshape(18, 2)
    assert speeds[away, 0] > 0.1
    assert speeds[away, 1] < -0.1


def test_all_agents_end_together():
    env = cells_env(duration_s=0.05)
    env.reset(seed=1)
    for _ in range(5):
        still = dict.fromkeys(env.agents, np.zeros(2, np.float32))
        _, _, _, late, _ = env.step(still)
    assert len(late) == 18
    assert all(late.values())
    assert env.agents == []


def test_an_episode_may_be_given():
    given = load_scenario("array18", ["parcel.0.x_m=0.07", "parcel.0.goal.x_m=-0.05"])
    env = cells_env()
    seen, _ = env.reset(seed=1, options={"scenario": given})
    assert env.episode.tables.motion[0][0, 0, 0] == 0.07
    centre_m = cell_centres(given.array)[0]
    assert seen["cell_1"][-4] == np.float32(-0.05 - centre_m[0])


def test_options_that_are_none_are_refused():
    with pytest.raises(InputError, match="an agent sets its own wheels"):
        cells_env(action="twist")
    with pytest.raises(InputError, match="nothing is drawn"):
        cells_env(render_mode="human")


def test_actions_of_no_agent_or_of_another_shape_are_refused():
    env = cells_env()
    env.reset(seed=1)
    still = np.zeros(2, np.float32)
    with pytest.raises(InputError, match="'cell_99' is no agent; there are cell_1 to cell_18"):
        env.step({"cell_99": still})
    # Together they have as many numbers as two cells, so each would drive the other's wheel.
    odd = {"cell_1": np.zeros(1, np.float32), "cell_2": np.zeros(3, np.float32)}
    with pytest.raises(InputError, match=r"cell_1 has the shape \(1,\), but must have \(2,\)"):
        env.step(odd)
    with pytest.raises(InputError, match=r"cell_1 has the shape \(\), but must have \(2,\)"):
        env.step({"cell_1": 0.5})
