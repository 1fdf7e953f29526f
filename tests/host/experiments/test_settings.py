"""Settings: grids, samples, seeds, and keys that are the truth, the belief or both."""

import numpy as np
import pytest

import mdms_array as mdms
from mdms_array.experiments.settings import (
    check_chance,
    meanings_of,
    seeds_of,
    settings_of,
    tree_of,
)
from mdms_model.scenario.belief import believed
from mdms_model.scenario.file import load_scenario, scenario_from
from mdms_model.scenario.tree import plain

BASE = plain(load_scenario("array18"))


def scenario_with(setting):
    return scenario_from(tree_of(BASE, setting, 7))


def test_lists_make_a_grid_whose_cells_have_the_same_samples():
    settings = settings_of(
        {"a": [1, 2], "b": mdms.uniform(0.0, 1.0), "c": ["x", "y"]}, 4, "latin_hypercube", 1
    )
    assert len(settings) == 16
    assert [*settings[0]] == ["a", "b", "c"]
    drawn = {(each["a"], each["c"]): [] for each in settings}
    for each in settings:
        drawn[each["a"], each["c"]].append(each["b"])
    assert len({tuple(values) for values in drawn.values()}) == 1
    # A sample of a Latin hypercube in each quarter.
    assert sorted(int(4 * value) for value in drawn[1, "x"]) == [0, 1, 2, 3]


@pytest.mark.parametrize("sampling", ["latin_hypercube", "sobol", "random"])
def test_samples_are_the_same_for_a_seed_and_others_for_another(sampling):
    over = {"a": mdms.uniform(0.0, 1.0), "b": mdms.uniform(2.0, 3.0)}
    first = settings_of(over, 8, sampling, 1)
    assert first == settings_of(over, 8, sampling, 1) != settings_of(over, 8, sampling, 2)


def test_a_setting_is_there_once_however_often_it_is_drawn():
    assert sorted(
        each["a"] for each in settings_of({"a": mdms.integers(1, 3)}, 16, "sobol", 1)
    ) == [*(1, 2, 3)]
    assert settings_of({"a": [2, 2]}, 1, "sobol", 1) == [{"a": 2}]


def test_distributions_keep_to_their_bounds():
    whole = mdms.integers(1, 3)
    assert [whole.at(share) for share in (0.0, 0.32, 0.34, 0.99, 1.0)] == [1, 1, 2, 3, 3]
    assert mdms.log_uniform(0.1, 10.0).at(0.5) == pytest.approx(1.0)
    assert mdms.uniform(-1.0, 1.0).at(0.25) == -0.5


def test_all_settings_see_the_seeds_of_the_rule():
    # The rule as documented: 48 bits of SHA-256 of 'SEED/REPLICATION'.
    assert seeds_of(2, 1) == [mdms.run_seed(1, 0), mdms.run_seed(1, 1)]
    assert mdms.run_seed(1, 0) == 27311190229672
    assert not {*seeds_of(100, 1)} & {*seeds_of(100, 2)}
    assert seeds_of([3, 5], 1) == seeds_of(np.array([3, 5]), 1) == [3, 5]
    assert seeds_of(np.int64(2), 1) == seeds_of(2, np.int64(1)) == seeds_of(2, 1)


def test_a_key_of_the_cell_is_both_truth_and_belief():
    scenario = scenario_with({"cell.friction": 0.2})
    assert (scenario.cell.friction, believed(scenario).cell.friction) == (0.2, 0.2)
    assert scenario.run.seed == 7


def test_truth_and_belief_vary_apart():
    truth = scenario_with({"truth.cell.friction": 0.2})
    assert (truth.cell.friction, believed(truth).cell.friction) == (0.2, 0.3)
    belief = scenario_with({"belief.friction": 0.2})
    assert (belief.cell.friction, believed(belief).cell.friction) == (0.3, 0.2)
    both = scenario_with({"truth.cell.friction": 0.2, "belief.friction": 0.4})
    assert (both.cell.friction, believed(both).cell.friction) == (0.2, 0.4)


def test_parcels_are_named_or_numbered():
    for key in ("truth.parcel.box.mass_kg", "truth.parcel.0.mass_kg"):
        scenario = scenario_with({key: 3.0})
        assert scenario.parcel[0].mass_kg == 3.0
        assert believed(scenario).parcel[0].mass_kg == 2.0


def meaning(key, *others, base=BASE):
    return meanings_of(base, [key, *others])[key]


def test_a_key_is_named_for_what_it_sets():
    assert meaning("cell.friction") == meaning("parcel.0.mass_kg") == "truth and belief"
    assert meaning("truth.cell.friction") == "truth alone"
    assert meaning("belief.friction") == "belief alone"
    assert meaning("motion.speed_m_s") == meaning("cell") == ""


def test_a_key_beside_a_belief_of_its_own_is_the_truth_alone():
    assert meaning("cell.friction", "belief.friction") == "truth alone"
    assert meaning("cell.friction", "belief.pwm_steps") == "truth and belief"
    assert meaning("parcel.0.mass_kg", "belief.box.mass_kg") == "truth alone"
    assert meaning("parcel.box.mass_kg", "belief.box.mass_kg") == "truth alone"
    told = BASE | {"belief": {"friction": 0.4, "box": {"mass_kg": 1.0}}}
    assert meaning("cell.friction", base=told) == "truth alone"
    assert meaning("parcel.0.mass_kg", base=told) == "truth alone"
    assert meaning("parcel.0.height_m", base=told) == "truth and belief"
    unknown = BASE | {"belief": {"box": {"known": False}}}
    assert meaning("parcel.0.mass_kg", base=unknown) == "truth alone"
    # With a belief that varies as a whole it may be the one or the other.
    assert meaning("cell.friction", "belief") == ""


def test_without_a_host_there_is_no_belief():
    row = plain(load_scenario("paper-fig8"))
    assert meaning("cell.friction", base=row) == ""
    assert meaning("cell.friction", "run.fidelity", base=row) == "truth and belief"


@pytest.mark.parametrize(
    "keys",
    [
        ("cell.friction", "truth.cell.friction"),
        ("parcel.0.mass_kg", "parcel.box.mass_kg"),
        ("parcel.0.mass_kg", "truth.parcel.00.mass_kg"),
        ("parcel.0", "parcel.0.mass_kg"),
        ("parcel.0", "parcel.box.mass_kg"),
        ("fault", "fault.0.start_s"),
        ("belief", "belief.friction"),
    ],
)
@pytest.mark.parametrize("turn", [1, -1])
def test_two_keys_of_one_value_are_refused(keys, turn):
    # Between them lies another key.
    setting = {keys[::turn][0]: 1.0, "cell.friction_spread": 0.1, keys[::turn][1]: 2.0}
    told = "^{} and {} set the same value; give one$"
    with pytest.raises(mdms.InputError, match=told.format(*keys)):
        tree_of(BASE, setting, 7)


@pytest.mark.parametrize("turn", [1, -1])
def test_the_order_of_truth_and_a_whole_belief_does_not_count(turn):
    setting = {"belief": {"friction": 0.4}, "truth.cell.friction": 0.2, "truth.cell.pwm_steps": 99}
    scenario = scenario_with(dict([*setting.items()][::turn]))
    own = believed(scenario).cell
    assert (scenario.cell.friction, own.friction) == (0.2, 0.4)
    assert (scenario.cell.pwm_steps, own.pwm_steps) == (99, BASE["cell"]["pwm_steps"])


def test_a_setting_leaves_the_base_as_it_was():
    scenario_with({"truth.cell.friction": 0.1, "parcel.box.mass_kg": 1.0})
    assert plain(load_scenario("array18")) == BASE


@pytest.mark.parametrize(
    ("key", "told"),
    [
        ("parcel.bx.mass_kg", "no parcel has that name; there are box"),
        ("parcel.3.mass_kg", "number parcel from 0 to 0"),
        ("truth.motion.speed_m_s", "the host has no belief of its own of this key"),
        ("truth.cell", "no belief of its own of this key; write cell, or a key of cell"),
        ("truth.parcel.0", "no belief of its own of this key; write parcel.0, or a key"),
        ("truth.parcel.box.inertia_kg_m2", "no value of this key for the host to believe"),
        ("cell.fricton", "did you mean friction?"),
    ],
)
def test_a_key_that_leads_nowhere_is_refused(key, told):
    with pytest.raises(mdms.InputError, match=told):
        scenario_with({key: 1.0})


@pytest.mark.parametrize(
    ("over", "samples", "sampling", "told"),
    [
        ({"a": np.array(0.3)}, 4, "sobol", "a is array.0.3., but must be a list of values"),
        ({"a": []}, 4, "sobol", "a has no values"),
        ({"a": 0.3}, 4, "sobol", "must be a list of values or a distribution"),
        ({"a": [0.3, float("nan")]}, 4, "sobol", "a has nan, but must have finite numbers"),
        ({"a": "low"}, 4, "sobol", "must be a list of values or a distribution"),
        ({"a": mdms.uniform(0, 1)}, 20, "sobol", "take 16 or 32"),
        ({"a": mdms.uniform(0, 1)}, 4, "halton", "must be one of latin_hypercube"),
        ({"a": [1]}, 4, "halton", "must be one of latin_hypercube"),
        ({"a": mdms.uniform(0, 1)}, 0, "random", "must be a whole number, 1 to"),
        ({"run.seed": [1, 2]}, 4, "sobol", "`seeds` says which seeds"),
        ({"a": range(2000), "b": range(2000)}, 1, "sobol", "4,000,000 settings, but at most"),
    ],
)
def test_settings_that_cannot_be_are_refused(over, samples, sampling, told):
    with pytest.raises(mdms.InputError, match=told):
        settings_of(over, samples, sampling, 1)


@pytest.mark.parametrize("sampling", ["latin_hypercube", "sobol", "random"])
def test_samples_need_a_seed_from_0_on(sampling):
    with pytest.raises(mdms.InputError, match="seed is -1, but must be 0 or more"):
        settings_of({"a": mdms.uniform(0, 1)}, 4, sampling, -1)


def test_rows_of_an_array_are_lists():
    places = np.array([[0.0, 0.0], [0.01, 0.0]])
    over = {"parcel.0.centre_of_mass_m": places, "cell.friction": np.array([0.2])}
    assert settings_of(over, 1, "random", 1) == [
        {"parcel.0.centre_of_mass_m": place, "cell.friction": 0.2}
        for place in ([0.0, 0.0], [0.01, 0.0])
    ]


@pytest.mark.parametrize("bounds", [(1.0, 1.0), (2.0, 1.0), (0.0, float("inf")), ("a", 1.0)])
def test_bounds_that_are_none_are_refused(bounds):
    with pytest.raises(mdms.InputError, match="two finite numbers"):
        mdms.uniform(*bounds)


def test_bounds_of_logarithms_are_above_0():
    with pytest.raises(mdms.InputError, match="above 0"):
        mdms.log_uniform(0.0, 1.0)


@pytest.mark.parametrize(
    "seeds",
    [0, -1, [], [1, 1], [1, -2], [True], True, 2.5, None, "12", {3, 5}, np.array(2.0)],
)
def test_seeds_that_are_none_are_refused(seeds):
    with pytest.raises(mdms.InputError, match="seeds is"):
        seeds_of(seeds, 1)


@pytest.mark.parametrize("seed", ["x", None, 1.5, True])
def test_a_seed_of_another_type_is_refused(seed):
    with pytest.raises(mdms.InputError, match=r"^seed is .*, but must be a whole number$"):
        mdms.sweep("array18", {"cell.friction": [0.2]}, seed=seed)


@pytest.mark.parametrize(
    ("over", "told"),
    [
        (None, "over is None, but must be a dict by keys of a scenario"),
        (["cell.friction"], "over is ..cell.friction.., but must be a dict"),
        ({5: [1]}, "over: 5 must be text, a key of a scenario"),
    ],
)
def test_keys_of_another_type_are_refused(over, told):
    with pytest.raises(mdms.InputError, match=told):
        mdms.sweep("array18", over)


@pytest.mark.parametrize("measures", [5, None, {"reached"}])
def test_measures_of_another_type_are_refused(measures):
    with pytest.raises(mdms.InputError, match=r"^measures is .*, but must be a list of names"):
        mdms.sweep("array18", {"cell.friction": [0.2]}, measures=measures)


ROW = plain(load_scenario("paper-fig8"))


def test_many_seeds_of_a_row_without_chance_are_refused():
    with pytest.raises(mdms.InputError, match=r"seeds: 20 are given, but run.fidelity is 'row'"):
        mdms.sweep("paper-fig8", {"cell.friction": [0.2, 0.3]})
    with pytest.raises(mdms.InputError, match=r"seeds: 2 are given, but run.fidelity is 'row'"):
        mdms.sweep("paper-fig8", {}, seeds=2)
    check_chance(ROW, ["cell.friction"], [1])


@pytest.mark.parametrize(
    "key", ["run", "run.fidelity", "cell", "cell.motor_spread", "truth.cell.friction_spread"]
)
def test_a_row_whose_chance_varies_has_many_seeds(key):
    check_chance(ROW, ["cell.friction", key], [1, 2])


def test_a_row_with_a_spread_has_many_seeds():
    check_chance(ROW | {"cell": ROW["cell"] | {"motor_spread": 0.1}}, ["cell.friction"], [1, 2])
