"""Measures: beliefs of parcels that are alike and of discs, and paths to figures."""

import threading
from functools import wraps
from math import nan
from types import FunctionType, SimpleNamespace

import numpy as np
import pytest

import mdms_array as mdms
from mdms_array.experiments.measures import (
    belief_position_error_m,
    belief_yaw_error_rad,
    check_measures,
    energy_j,
    identity_of,
    known_figures,
    measure_named,
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


@pytest.mark.parametrize(("fidelity", "power_w"), [("firmware", 16.0), ("ideal", 36.0)])
def test_the_energy_of_a_stalled_motor_is_that_of_the_current_at_which_its_bridge_limits(
    fidelity, power_w
):
    """12 V at 4 ohm are 3 A and 36 W, but 2 A need no more than 8 V."""
    cell = {"current_limit_a": 2.0, "resistance_ohm": 4.0}
    scenario = scenario_from(
        {"scenario": "array18", "cell": cell, "run": {"fidelity": fidelity}}
        | {"parcel": [BOX], "motion": {"field": "uniform"}}
    )
    record = SimpleNamespace(
        time_s=np.array([0.0, 0.5]), voltage_v=np.full((2, 1), 12.0), speed_m_s=np.zeros((2, 1))
    )
    run = Run(scenario, "reached", "", record, {}, {})
    assert energy_j(run) == pytest.approx(0.5 * power_w)


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


VALUE = 1.0


def by_global(_run):
    return VALUE


def by_method(_run):
    return Half().of()


class Half:
    @staticmethod
    def of():
        return Half.scale() / 2.0

    @staticmethod
    def scale():
        return VALUE


def doubled(measure):
    @wraps(measure)
    def wrapped(run):
        return VALUE * measure(run)

    return wrapped


@doubled
def by_decorator(_run):
    return 1.0


class Held:
    def __init__(self, value):
        self.value = value


@pytest.mark.parametrize("measure", [by_global, by_method, by_decorator])
@pytest.mark.parametrize(
    ("value", "other"),
    [
        (1.0, 2.0),
        (np.array([1.0]), np.array([2.0])),
        (np.array([1, 2]), np.array([[1, 2]])),
        ({"a", "b"}, {"a", "c"}),
        ([{1.0}], [{2.0}]),
        (Held(1.0), Held(2.0)),
        (Held(np.zeros(2000)), Held(np.eye(1, 2000, 1000)[0])),
        (lambda: 1.0, lambda: 2.0),
        (Held(1.0).__init__, Held(2.0).__init__),
    ],
)
def test_a_measure_is_another_if_a_value_that_it_uses_is(measure, value, other, monkeypatch):
    monkeypatch.setitem(globals(), "VALUE", value)
    before = identity_of(measure)
    assert identity_of(measure) == before
    monkeypatch.setitem(globals(), "VALUE", other)
    assert identity_of(measure) != before


def test_a_measure_is_another_with_other_defaults():
    def with_defaults(defaults, keywords=None):
        made = FunctionType(by_global.__code__, globals(), "by_global", defaults)
        made.__kwdefaults__ = keywords
        return identity_of(made)

    assert with_defaults((1.0,)) == with_defaults((1.0,))
    identities = {with_defaults((1.0,)), with_defaults((2.0,)), with_defaults(None, {"a": 1.0})}
    assert len(identities) == 3


def test_sets_have_one_text_in_all_orders(monkeypatch):
    identities = set()
    # Both have the same place in a table of eight.
    for value in ({0, 8}, {8, 0}):
        monkeypatch.setitem(globals(), "VALUE", value)
        identities.add(identity_of(by_global))
    assert len(identities) == 1


def test_a_value_that_holds_itself_has_an_end(monkeypatch):
    endless = [1.0]
    endless.append(endless)
    monkeypatch.setitem(globals(), "VALUE", endless)
    assert identity_of(by_global) == identity_of(by_global)


async def never_awaited(_run):
    return 1.0


def test_a_measure_that_nothing_would_await_is_refused(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("async def never_awaited(run): return 1.0\n")
    for measure in (never_awaited, measure_named(f"{path}:never_awaited", tmp_path)):
        with pytest.raises(mdms.InputError, match="never_awaited is an `async def`, but nothing"):
            check_measures([measure])


def test_a_value_that_nobody_can_compare_is_refused(monkeypatch):
    monkeypatch.setitem(globals(), "VALUE", threading.Lock())
    told = r"by_global uses by_global: VALUE, a value that cannot be compared .* \(cannot pickle"
    with pytest.raises(mdms.InputError, match=told):
        check_measures([by_global])
