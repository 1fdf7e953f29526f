"""The false beliefs of the host: keys of the cell, and of parcels by name."""

from dataclasses import replace

import pytest

from mdms_model.scenario.belief import believed
from mdms_model.scenario.file import load_scenario, scenario_from
from mdms_model.scenario.scenario import ScenarioError
from mdms_model.scenario.tree import plain


def test_without_beliefs_the_truth_is_believed():
    scenario = load_scenario("array18")
    assert believed(scenario) == scenario


def test_a_belief_differs_from_the_truth_in_its_own_keys():
    overrides = ["belief.box.length_m=0.38", "belief.friction=0.2", "belief.box.mass_kg=3"]
    scenario = load_scenario("array18", overrides)
    truth = load_scenario("array18")
    assert replace(scenario, belief={}) == truth
    taken = believed(scenario)
    assert taken.cell == replace(truth.cell, friction=0.2)
    assert taken.parcel == (replace(truth.parcel[0], length_m=0.38, mass_kg=3.0),)


def test_a_parcel_that_the_host_is_not_told_of_is_left_out():
    scenario = load_scenario("passing2")
    lying = replace(scenario.parcel[1], goal=None)
    unknown = {lying.name: {"known": False}}
    taken = believed(replace(scenario, parcel=(scenario.parcel[0], lying), belief=unknown))
    assert taken.parcel == scenario.parcel[:1]


def test_beliefs_survive_a_round_trip():
    scenario = load_scenario("array18", ["belief.box.x_m=0.1", "belief.wheel_radius_m=0.026"])
    assert scenario_from(plain(scenario)) == scenario


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("belief=3", "belief is 3, but must be a table"),
        ("belief.frction=0.2", "belief.frction is not a known key; did you mean friction?"),
        ("belief.friction=-1", "belief.friction is -1, but must be at least 0 and at most 1e+06"),
        ("belief.bax.length_m=1", "belief.bax: no parcel has that name; there are box"),
        ("belief.box.lenght_m=1", "belief.box.lenght_m is not a known key; did you mean length_m?"),
        ("belief.box.length_m=0", "belief.box.length_m is 0, but must be at least 0.001"),
        ("belief.box.name='x'", "belief.box.name cannot differ"),
        ("belief.box.x_m=2", "belief.box.x_m is 2.0, which puts the centre of mass of 'box' off"),
        ("belief.wheel=[{}]", "belief.wheel has 1 items, but must have 2, as cell.wheel has"),
        ("belief.sensor_offset_m=[[0.0, 0.0]]", "belief.sensor_offset_m has 1 items, but must"),
        ("belief.box.shape='disc'", "belief.box:"),
        ("belief.box.known=0", "belief.box.known is 0, but must be true or false"),
        ("belief.box.known=false", "belief.box.known is false, but the parcel has a goal"),
        ("belief.box={known=false, x_m=0.1}", "belief.box.known is false, so that belief.box.x_m"),
    ],
)
def test_a_belief_that_cannot_be_is_refused_by_its_key(override, expected):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("array18", [override])
    assert str(caught.value).startswith(f"array18: {expected}")


def test_a_belief_needs_a_host():
    with pytest.raises(ScenarioError, match=r"belief needs a host, which run\.fidelity 'row' has"):
        load_scenario("paper-fig7", ["belief.friction=0.2"])
