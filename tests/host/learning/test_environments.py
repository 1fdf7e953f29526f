"""Environments of Gymnasium: its checker, seeds, many tables beside one, both fidelities."""

import warnings
from math import nan

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import mdms_array as mdms
import mdms_array.learning
from mdms_array.extras import LEARN
from mdms_array.learning.actions import Actions
from mdms_array.learning.episodes import Episodes
from mdms_array.learning.tasks import REACHED_M, REACHED_RAD
from mdms_model.array import build_wheels
from mdms_model.errors import Error, InputError
from mdms_model.fields import references_m_s as field_m_s
from mdms_model.motor import drive_of
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.motion import Part
from mdms_model.scenario.scenario import Array, Scenario

PARCEL, SORT = "mdms/Parcel-v0", "mdms/Sort-v0"
BOX = {"name": "box", "mass_kg": 2.0, "length_m": 0.3, "width_m": 0.2, "x_m": 0.0, "y_m": 0.0}
INWARD = {"motion": {"field": "inward"}, "run": {"fidelity": "ideal"}}
SPREAD = {"cell.friction": mdms.uniform(0.15, 0.4), "run.seed": mdms.integers(0, 1000)}


def lived(env, seed, steps, chance=3):
    """All that an environment shows from a seed on, under actions by chance."""
    actions = np.random.default_rng(chance)
    seen, _infos = env.reset(seed=seed)
    shown = [seen]
    for _ in range(steps):
        shown.append(env.step(actions.uniform(-1, 1, env.action_space.shape).astype(np.float32)))
    env.close()
    return shown


def same(one, other):
    """Whether two observations, steps or infos are the same to the last bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        pairs = zip(one, other, strict=True)
        return all(same(mine, theirs) for mine, theirs in pairs)
    return np.asarray(one).tobytes() == np.asarray(other).tobytes()


@pytest.mark.parametrize("name", [PARCEL, SORT])
def test_gymnasiums_checker_passes_each_environment(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*not within the observation space.*")
        check_env(gymnasium.make(name).unwrapped, skip_render_check=True)


def test_gymnasiums_checker_passes_cells_with_firmware():
    check_env(gymnasium.make(PARCEL, fidelity="firmware").unwrapped, skip_render_check=True)


@pytest.mark.parametrize("action", ["wheels", "twist", "squeeze"])
def test_the_same_seed_shows_the_same(action):
    ways = [
        lived(gymnasium.make(PARCEL, action=action, randomise=SPREAD), seed, 60)
        for seed in (5, 5, 6)
    ]
    assert same(ways[0], ways[1])
    assert not same(ways[0], ways[2])


def test_the_same_seed_shows_the_same_with_firmware():
    ways = [lived(gymnasium.make(PARCEL, fidelity="firmware"), seed, 30) for seed in (5, 5)]
    assert same(*ways)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("more", [{}, SPREAD])
def test_each_of_many_tables_does_what_one_does_alone(threads, more):
    options = {
        "duration_s": 0.3,
        "randomise": {**mdms_array.learning.environments.PARCEL["randomise"], **more},
    }
    many = gymnasium.make_vec(PARCEL, num_envs=5, threads=threads, **options)
    assert type(many.unwrapped).__name__ == "ParcelVectorEnv"
    actions = np.random.default_rng(0).uniform(-1, 1, (70, 5, 36)).astype(np.float32)
    seen, _ = many.reset(seed=11)
    steps = [many.step(each) for each in actions]
    for k in range(5):
        one = gymnasium.make(PARCEL, **options).unwrapped
        own, _ = one.reset(seed=11 + k)
        assert same({key: each[k] for key, each in seen.items()}, own)
        over = False
        for action, (after, rewards, ended, late, _) in zip(actions, steps, strict=True):
            if over:
                own, _ = one.reset()
                reward, end, limit = 0.0, False, False
            else:
                own, reward, end, limit, _ = one.step(action[k])
            over = end or limit
            assert same({key: each[k] for key, each in after.items()}, own)
            assert (rewards[k], ended[k], late[k]) == (reward, end, limit)


def test_an_end_is_told_once_though_its_table_begins_anew():
    still = {f"parcel.0.{key}": [0.0] for key in ("x_m", "y_m", "yaw_rad")}
    goal = {f"parcel.0.goal.{key}": [0.0] for key in ("x_m", "y_m", "yaw_rad")}
    many = gymnasium.make_vec(PARCEL, num_envs=2, randomise=still | goal)
    many.reset(seed=1)
    steps = [many.step(np.zeros((2, 36), np.float32)) for _ in range(4)]
    assert [ended.tolist() for _, _, ended, _, _ in steps] == 2 * [[True] * 2, [False] * 2]
    for _, _, ended, _, infos in steps:
        for name in ("reached", "tipped", "position_error_m", "yaw_error_rad"):
            assert (infos[f"_{name}"] == ended).all()
        assert (infos["reached"] == ended).all()


def test_cells_with_firmware_follow_the_actions():
    env = gymnasium.make(PARCEL, fidelity="firmware", most_m_s=0.2).unwrapped
    seen, _ = env.reset(seed=1)
    away = ~seen["presence"].reshape(18, 5).any(axis=1)
    action = np.tile([1.0, -0.5], 18).astype(np.float32)
    for _ in range(40):
        seen, *_ = env.step(action)
    speeds = seen["wheel_speed_m_s"].reshape(18, 2)[away]
    ratios = speeds / (0.2 * np.array([1.0, -0.5]) * drive_of(env.episode.scenario.cell).droop)
    assert len(speeds) > 2
    assert ratios == pytest.approx(np.ones_like(ratios), rel=0.1)
    env.close()


@pytest.mark.parametrize("field", ["uniform", "rotate", "inward", "squeeze", "elliptic", "linear"])
def test_an_action_of_a_field_is_that_field(field):
    scenario = load_scenario("array18")
    actions = Actions(scenario, field, 0.4)
    chosen = np.random.default_rng(1).uniform(-1, 1, (3, len(actions.names)))
    references_m_s = actions.references_m_s(chosen)
    assert references_m_s.shape == (3, 36)
    for action, own_m_s in zip(chosen, references_m_s, strict=True):
        shares = dict(zip(actions.names, action, strict=True))
        wheels = build_wheels(scenario)
        edge_m = abs(wheels.position_m).max(axis=0)
        reach_m = np.hypot(*wheels.position_m.T).max()
        part = Part(
            field,
            speed_m_s=0.4 * shares.get("speed_m_s", 0.0),
            heading_rad=np.pi * shares.get("heading_rad", 0.0),
            ratio=0.5 + 0.5 * shares.get("ratio", 0.0),
            centre_m=tuple(edge_m * [shares.get(f"centre_m.{n}", 0.0) for n in (0, 1)]),
            velocity_m_s=tuple(0.4 * shares.get(f"velocity_m_s.{n}", 0.0) for n in (0, 1)),
            gradient_per_s=tuple(
                tuple(0.4 / reach_m * shares.get(f"gradient_per_s.{n}", 0.0) for n in row)
                for row in ((0, 1), (2, 3))
            ),
        )
        np.testing.assert_allclose(own_m_s, field_m_s(part, wheels), atol=1e-12)


@pytest.mark.parametrize("field", ["twist", "linear"])
def test_no_turn_moves_the_only_wheel_in_the_middle(field):
    scenario = Scenario("one", Array(1, 1))
    actions = Actions(scenario, field, 0.4)
    chosen = [0.5 if name == "velocity_m_s.0" else 1.0 for name in actions.names]
    assert actions.references_m_s(np.array([chosen])).tolist() == [[0.2]]


@pytest.mark.parametrize("field", ["twist", "linear"])
def test_references_of_many_tables_are_those_of_each_alone(field):
    actions = Actions(load_scenario("sort54"), field, 0.5)
    chosen = np.random.default_rng(1).uniform(-1, 1, (50, len(actions.names)))
    for tables in (2, 3, 50):
        many = actions.references_m_s(chosen[:tables])
        for action, own_m_s in zip(chosen, many, strict=False):
            assert same(actions.references_m_s(action[None])[0], own_m_s)


def test_a_step_is_a_control_period_of_the_table():
    for fidelity in ("ideal", "firmware"):
        env = gymnasium.make(PARCEL, fidelity=fidelity).unwrapped
        env.reset(seed=1)
        before_s = env.episode.tables.worlds[0].time_s
        for _ in range(7):
            env.step(np.zeros(36, np.float32))
        assert env.episode.tables.worlds[0].time_s - before_s == pytest.approx(0.07)
        env.close()


def steered(env, seen, steps):
    """Rewards and the last infos of a controller that goes straight to the goal."""
    rewards = []
    for _ in range(steps):
        x, y, _cosine, _sine = seen["goal"] - seen["pose"]
        turn = seen["goal"][3] * seen["pose"][2] - seen["goal"][2] * seen["pose"][3]
        seen, reward, ended, late, infos = env.step(
            np.clip([12 * x, 12 * y, 6 * turn], -1, 1).astype(np.float32)
        )
        rewards.append(reward)
        if ended or late:
            return rewards, ended, infos
    return rewards, False, infos


@pytest.mark.parametrize("fidelity", ["ideal", "firmware"])
def test_a_parcel_that_is_brought_to_its_goal_ends_the_episode(fidelity):
    env = gymnasium.make(PARCEL, fidelity=fidelity, action="twist").unwrapped
    seen, _ = env.reset(seed=2)
    way_m = np.hypot(*(seen["goal"] - seen["pose"])[:2])
    rewards, ended, infos = steered(env, seen, 900)
    assert ended
    assert infos["reached"]
    assert not infos["tipped"]
    assert infos["position_error_m"] <= REACHED_M
    assert infos["yaw_error_rad"] <= REACHED_RAD
    assert sum(rewards) > 1.0 + way_m - REACHED_M
    env.close()


def test_a_parcel_that_tips_ends_the_episode_and_costs_one():
    env = gymnasium.make(PARCEL, action="uniform", most_m_s=1.0).unwrapped
    env.reset(seed=1)
    for _ in range(900):
        _, reward, ended, _, infos = env.step(np.array([0.0, 1.0], np.float32))
        if ended:
            break
    assert ended
    assert infos["tipped"]
    assert not infos["reached"]
    assert reward < -0.9


def test_parcels_that_leave_by_their_exits_are_worth_one_each():
    env = gymnasium.make(SORT, action="twist", most_m_s=0.5).unwrapped
    seen, _ = env.reset(seed=4)
    infos, worth = {"sorted": 0, "wrong": 0}, 0.0
    before = 0
    for _ in range(1500):
        # All parcels go east, whatever their kind: right for some, wrong for others.
        seen, reward, ended, _late, infos = env.step(np.array([1.0, 0.0, 0.0], np.float32))
        gone = infos["sorted"] - infos["wrong"]
        assert abs(reward - (gone - before)) < 0.2
        before, worth = gone, worth + reward
        assert not ended
    assert infos["sorted"] > 0
    assert infos["wrong"] > 0
    assert seen["on_table"].sum() >= 1
    assert not seen["pose"][seen["on_table"] == 0].any()


def test_seeds_bring_other_streams():
    ways = [lived(gymnasium.make(SORT, action="twist"), seed, 200) for seed in (1, 2, 1)]
    assert same(ways[0], ways[2])
    assert not same(ways[0], ways[1])


def test_keys_are_drawn_for_each_episode_from_their_distributions():
    episodes = Episodes(
        "array18",
        {"cell.friction": mdms.uniform(0.1, 0.2), "parcel.box.mass_kg": [1.0, 3.0]}
        | {"parcel.box.goal.x_m": mdms.uniform(-0.1, 0.0), "truth.cell.gain_vs_per_m": [8.0]},
    )
    chance = np.random.default_rng(1)
    drawn = [episodes.draw(chance) for _ in range(40)]
    frictions = {each.cell.friction for each in drawn}
    assert len(frictions) == 40
    assert min(frictions) >= 0.1
    assert max(frictions) <= 0.2
    assert {each.parcel[0].mass_kg for each in drawn} == {1.0, 3.0}
    assert all(-0.1 <= each.parcel[0].goal.x_m <= 0.0 for each in drawn)
    assert {each.cell.gain_vs_per_m for each in drawn} == {8.0}


def test_lists_of_numpy_are_those_of_python():
    episodes = Episodes("array18", {"parcel.box.mass_kg": np.array([2, 3])})
    assert {episodes.draw(np.random.default_rng(k)).parcel[0].mass_kg for k in range(9)} == {2, 3}


def test_poses_alone_are_drawn_as_a_scenario_has_them():
    keys = {"parcel.0.x_m": [0.05], "parcel.box.yaw_rad": [0.3], "parcel.0.goal.y_m": [0.02]}
    fast = Episodes("array18", keys).draw(np.random.default_rng(0))
    changes = ["parcel.0.x_m=0.05", "parcel.0.yaw_rad=0.3", "parcel.0.goal.y_m=0.02"]
    assert fast == load_scenario("array18", changes)


def test_an_episode_may_be_given():
    given = load_scenario("array18", ["parcel.0.x_m=0.07", "parcel.0.goal.x_m=-0.05"])
    one = gymnasium.make(PARCEL).unwrapped
    seen, _ = one.reset(options={"scenario": given})
    assert seen["pose"][0] == np.float32(0.07)
    assert seen["goal"][0] == np.float32(-0.05)
    many = gymnasium.make_vec(PARCEL, num_envs=2).unwrapped
    seen, _ = many.reset(seed=1, options={"scenarios": [None, given]})
    assert seen["pose"][1, 0] == np.float32(0.07)
    assert seen["pose"][0, 0] != np.float32(0.07)
    two = load_scenario("swap2")
    with pytest.raises(InputError, match="its array differs from that of the first table"):
        one.reset(options={"scenario": two})
    with pytest.raises(InputError, match="1 are given, but there are 2 tables"):
        many.reset(options={"scenarios": [given]})
    for seeds in ([1], [1, 2, 3]):
        with pytest.raises(InputError, match=f"seed: {len(seeds)} are given, but there are 2"):
            many.reset(seed=seeds)


def test_actions_that_are_none_are_refused():
    one, many = gymnasium.make(PARCEL).unwrapped, gymnasium.make_vec(PARCEL, num_envs=2)
    one.reset(seed=1)
    many.reset(seed=1)
    with pytest.raises(InputError, match="action: it has NaN, but must have numbers from -1 to 1"):
        one.step(np.full(36, nan, np.float32))
    with pytest.raises(InputError, match=r"action: its shape is \(1,\), but must be \(1, 36\)"):
        one.step(np.float32(0.5))
    with pytest.raises(InputError, match="action: it has object, but must have numbers"):
        one.step(np.array([None] * 36))
    with pytest.raises(InputError, match=r"its shape is \(36,\), but must be \(2, 36\)"):
        many.step(np.zeros(36, np.float32))


def test_sensors_are_late_and_noisy_as_the_scenario_says():
    quiet = gymnasium.make(PARCEL, scenario={"scenario": "array18", "cell": {"sensor_noise": 0.0}})
    noisy = gymnasium.make(PARCEL, scenario={"scenario": "array18", "cell": {"sensor_noise": 0.2}})
    ways = [lived(env, 3, 20) for env in (quiet, noisy, noisy)]
    wrong = np.mean(
        [
            a[0]["presence"] != b[0]["presence"]
            for a, b in zip(ways[0][1:], ways[1][1:], strict=True)
        ]
    )
    assert 0.12 < wrong < 0.28
    assert same(ways[1], ways[2])
    with pytest.raises(InputError, match=r"late by less than 0\.01 s; take fidelity='firmware'"):
        gymnasium.make(PARCEL, scenario={"scenario": "array18", "cell": {"sensor_delay_s": 0.02}})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fidelity": "row"}, "fidelity is 'row', but must be ideal or firmware"),
        ({"action": "goal"}, "action is 'goal', but must be 'wheels' or a field: uniform, "),
        ({"most_m_s": 0.0}, "most_m_s is 0.0, but must be above 0"),
        ({"duration_s": 0.0}, "duration_s is 0.0, but must be 0.01 to 3600 seconds"),
        ({"duration_s": "10"}, "duration_s is '10', but must be 0.01 to 3600 seconds"),
        ({"most_m_s": "fast"}, "most_m_s is 'fast', but must be above 0"),
        ({"action": ["twist"]}, "action is ..twist.., but must be 'wheels' or a field"),
        ({"randomise": None}, "randomise is None, but must be a dict by keys of a scenario"),
        ({"randomise": {1: [0.0]}}, "randomise is {1: .0.0.}, but must be a dict by keys"),
        ({"randomise": {"run.seed": [1.5]}}, "run.seed is .1.5., but must be whole numbers"),
        ({"randomise": {"run.seed": ["a"]}}, "run.seed is .'a'., but must be whole numbers"),
        ({"randomise": {"run.seed": mdms.uniform(0, 9)}}, "must be whole numbers; take mdms_arr"),
        ({"foo": 1}, "foo is no option of the environment; there are scenario, fidelity"),
        ({"randomise": {"cell.friction": np.array(0.2)}}, "friction is array.0.2., but must be a"),
        ({"threads": 0}, "threads is 0, but must be a whole number"),
        ({"randomise": {"cell.friction": 0.3}}, "a distribution, such as mdms_array.uniform"),
        ({"randomise": {"parcel.0.x_m": [nan]}}, "parcel.0.x_m is nan, but must be a finite"),
        ({"randomise": {"parcel.box.x_m": ["a"]}}, "parcel.box.x_m is 'a', but must be a number"),
        (
            {"randomise": {"parcel.0.goal.yaw_rad": mdms.uniform(-9.0, 9.0)}},
            "goal.yaw_rad is -9.0, but",
        ),
        (
            {"randomise": {"parcel.box.x_m": mdms.uniform(-0.1, 5.0)}},
            "parcel.0.x_m is 5.0, which puts the centre of mass of 'box' off the table",
        ),
        (
            {"randomise": {"parcel.box.goal.y_m": [0.0, -1.0]}},
            "parcel.0.goal.y_m is -1.0, which puts the goal off the table",
        ),
        (
            {"scenario": "passing2", "randomise": {"parcel.0.x_m": [0.3], "parcel.0.y_m": [-0.1]}},
            "begin .* mm within each other",
        ),
        ({"scenario": "nowhere"}, "nowhere: no such scenario file"),
        ({"randomise": {"cell.frictoin": [0.1]}}, "frictoin"),
        ({"scenario": {"scenario": "array18", "fault": [{"kind": "loss"}]}}, "has none; take fid"),
        ({"scenario": "sort54"}, "take mdms/Sort-v0"),
        ({"scenario": {"scenario": "array18", "parcel": [], **INWARD}}, "the scenario has no parc"),
    ],
)
def test_options_that_make_no_environment_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        gymnasium.make(PARCEL, **{"randomise": {}, **options})


def test_what_tables_share_is_drawn_for_none():
    env = gymnasium.make(PARCEL, randomise={"cell.sensor_delay_s": [0.002]})
    with pytest.raises(InputError, match="is drawn for each episode"):
        env.reset()


def test_resets_refuse_what_they_do_not_take():
    one, many = gymnasium.make(PARCEL).unwrapped, gymnasium.make_vec(PARCEL, num_envs=2)
    with pytest.raises(InputError, match="'scenarios' is given, but this reset takes 'scenario'"):
        one.reset(options={"scenarios": ["array18"]})
    with pytest.raises(InputError, match="'reset_mask' is given, but this reset takes 'scenar"):
        many.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(InputError, match="scenarios: 'array18' is no list"):
        many.reset(options={"scenarios": "array18"})
    for seed in (1.5, np.array([1, 2])):
        with pytest.raises(InputError, match="but must be a whole number, or a list of one for"):
            many.reset(seed=seed)


def test_a_step_without_an_episode_is_refused():
    for env in (gymnasium.make(PARCEL).unwrapped, gymnasium.make_vec(PARCEL, num_envs=2)):
        with pytest.raises(InputError, match="no episode has begun; call reset first"):
            env.step(np.zeros(env.action_space.shape))


def test_an_episode_that_is_refused_leaves_none_behind():
    env = gymnasium.make(PARCEL).unwrapped
    env.reset(seed=1)
    goalless = {"scenario": "array18", "parcel": [BOX], **INWARD}
    with pytest.raises(InputError, match="parcel 'box' has no goal; give it one"):
        env.reset(options={"scenario": goalless})
    with pytest.raises(InputError, match="no episode has begun; call reset first"):
        env.step(np.zeros(36))


@pytest.mark.parametrize("fidelity", ["ideal", "firmware"])
def test_an_episode_on_another_table_is_refused(fidelity):
    env = gymnasium.make(PARCEL, fidelity=fidelity).unwrapped
    wider = load_scenario("array18", ["array.columns=7"])
    with pytest.raises(InputError, match="its array differs from that of the first table"):
        env.reset(options={"scenario": wider})
    env.close()


def test_cells_with_fewer_wheels_are_within_the_space():
    fewer = {"patch": [{"cells": [1, 2], "wheel": [{"direction_rad": 0.0}]}]}
    table = {"scenario": "array18", "parcel": [BOX], **INWARD, **fewer}
    env = gymnasium.make(PARCEL, scenario=table).unwrapped
    seen, _ = env.reset(seed=1)
    assert env.action_space.shape == seen["wheel_speed_m_s"].shape == (34,)
    assert env.observation_space.contains(seen)


def test_an_episode_has_the_exits_of_its_own_scenario():
    env = gymnasium.make(SORT).unwrapped
    seen, _ = env.reset(seed=1)
    kinds = ["small", "medium", "large", "disc"]
    turned = {"exit": [{"name": "all", "side": "west", "kinds": kinds}]}
    others, _ = env.reset(options={"scenario": {"scenario": "sort54", **turned}})
    edge_m = -env.episode.scenario.array.columns * env.episode.scenario.array.pitch_m / 2
    assert (others["exit_m"][:, 0] == np.float32(edge_m)).all()
    assert (seen["exit_m"][:, 0] > 0.0).all()


def test_a_scenario_without_exits_sorts_nothing():
    with pytest.raises(InputError, match="no exit or no stream"):
        gymnasium.make(SORT, scenario="array18", randomise={})


def test_a_missing_extra_is_named(monkeypatch):
    monkeypatch.setattr(
        "mdms_array.extras.find_spec", lambda name: None if name == "pettingzoo" else name
    )
    from mdms_array.extras import require

    with pytest.raises(
        Error, match=r"pip install 'mdms-array\[learn\]'; not installed: pettingzoo"
    ):
        require(LEARN, "mdms_array.learning")
