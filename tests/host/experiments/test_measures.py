"""Measures: beliefs of parcels that are alike and of discs, and paths to figures."""

from math import nan

import numpy as np
import pytest

import mdms_array as mdms
from mdms_array.experiments.measures import (
    belief_position_error_m,
    belief_yaw_error_rad,
    check_measures,
    known_figures,
    measured,
)
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


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("parcels.0.xm", "parcels.0.xm: parcels.0 has no 'xm'; there are x_m"),
        ("parcels.box.estimate.z_m", "parcels.box.estimate has no 'z_m'; there are y_m, x_m"),
        ("parcel.0.x_m", "a run has no 'parcel'; there are parcels"),
        ("a.b.c", "a run has no 'a'; there are title, "),
        (".", "a run has no ''; there are title, "),
        ("parcels..x_m", "parcels has no ''; there are NAME"),
        ("violations.box.rule", "violations has no 'box'; there are NUMBER"),
        ("parcels.0", "parcels.0 has more than one figure; add one of name, x_m"),
        ("bus.load.x", "bus.load is one figure, with no 'x' inside"),
        ("loads", "'loads' is unknown; there are reached"),
    ],
)
def test_a_path_to_no_figure_is_refused(path, told):
    with pytest.raises(mdms.InputError, match=f"^measures: .*{told}"):
        check_measures([path])


def paths_of(figures, above=()):
    """The paths of all figures, each as a tuple."""
    if isinstance(figures, list | tuple):
        figures = dict(enumerate(figures))
    if not isinstance(figures, dict):
        return [above]
    return [path for key, each in figures.items() for path in paths_of(each, (*above, str(key)))]


@pytest.mark.parametrize("changes", [{"scenario": "paper-fig8"}, {"scenario": "sort54"}])
def test_all_figures_of_a_run_are_known(changes):
    run = mdms.simulate(changes | {"run": {"duration_s": 0.2}})
    paths = [".".join(path) for path in paths_of(run.figures) if len(path) > 1]
    assert check_measures(paths) == (*paths,)
    assert all(path[0] in known_figures() for path in paths_of(run.figures))


def test_a_parcel_of_a_path_has_a_number_or_a_name():
    goals = [{"parcel": "a", "reached": True}, {"parcel": "b", "reached": False}]
    figures = {"parcels": [{"name": "a", "x_m": 1.0}, {"name": "b", "x_m": 2.0}], "goals": goals}
    run = Run(None, "reached", "", None, figures, {})
    paths = "parcels.1.x_m", "parcels.b.x_m", "goals.b.reached", "parcels.c.x_m", "parcels.2.x_m"
    assert [measured(run, path) for path in paths] == [2.0, 2.0, False, None, None]
