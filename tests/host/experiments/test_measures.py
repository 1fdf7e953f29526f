"""Measures of beliefs: of parcels that are alike, and of discs."""

from math import nan

import numpy as np
import pytest

from mdms_array.experiments.measures import belief_position_error_m, belief_yaw_error_rad
from mdms_array.run import ParcelRun, Run
from mdms_model.scenario.file import scenario_from

BOX = {"name": "box", "mass_kg": 2.0, "length_m": 0.36, "width_m": 0.3}
UNKNOWN = (nan, nan, nan)


def run_of(parcels, poses):
    """A run that ends with these true and believed poses of these parcels."""
    scenario = scenario_from(
        {"scenario": "array54", "parcel": parcels, "motion": {"field": "program"}}
    )
    time_s = np.zeros(1)
    runs = {
        parcel.name: ParcelRun(parcel.name, time_s, np.array([true]), np.array([believed]))
        for parcel, (true, believed) in zip(scenario.parcel, poses, strict=True)
    }
    return Run(scenario, "reached", "", None, {}, runs)


def two(kind):
    return [
        BOX | {"name": name, "kind": kind, "x_m": x_m} for name, x_m in (("a", -0.3), ("b", 0.3))
    ]


AT_A, AT_B = (-0.3, 0.0, 0.1), (0.3, 0.0, 0.2)


def test_beliefs_of_a_kind_count_for_the_nearest_of_it():
    swapped = [(AT_A, AT_B), (AT_B, (-0.304, 0.003, 0.1))]
    assert belief_position_error_m(run_of(two("box"), swapped)) == pytest.approx(0.005)
    assert belief_yaw_error_rad(run_of(two("box"), swapped)) == pytest.approx(0.0)
    # Parcels of no kind are themselves.
    assert belief_position_error_m(run_of(two(""), swapped)) > 0.5


def test_each_belief_counts_for_one_parcel():
    both_at_a = [(AT_A, AT_A), (AT_B, (-0.29, 0.0, 0.1))]
    assert belief_position_error_m(run_of(two("box"), both_at_a)) == pytest.approx(0.59)
    one_is_away = [(UNKNOWN, AT_B), (AT_B, UNKNOWN)]
    assert belief_position_error_m(run_of(two("box"), one_is_away)) == 0.0
    assert belief_position_error_m(run_of(two("box"), [(AT_A, UNKNOWN)] * 2)) is None


def test_the_turn_of_a_disc_is_no_error():
    disc = BOX | {"name": "disc", "shape": "disc", "width_m": 0.36}
    run = run_of(
        [BOX | {"x_m": -0.3}, disc | {"x_m": 0.3}], [(AT_A, AT_A), (AT_B, (0.3, 0.0, 2.0))]
    )
    assert belief_yaw_error_rad(run) == 0.0
    assert belief_position_error_m(run) == 0.0
    alone = run_of([disc], [(AT_B, (0.3, 0.0, 2.0))])
    assert belief_yaw_error_rad(alone) is None
