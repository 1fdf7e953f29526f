import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_sim.physics.drive import drive_of
from mdms_sim.physics.limits import (
    normal_max_n,
    normal_min_n,
    parcel_limits,
    rolling_max_m_s,
    rolls,
    whole_pitches,
)
from mdms_sim.physics.normal_bounds import normals_at
from mdms_sim.scenario import Array, Cell, Parcel, Scenario, ScenarioError, Wheel

PITCH_M = 0.127


def paper(resistance_ohm=4.0, **parcel):
    box = {"mass_kg": 2.0, "length_m": 0.4445, "width_m": 0.1} | parcel
    return Scenario(
        "paper",
        Array(10, 1, PITCH_M),
        Cell(resistance_ohm=resistance_ohm),
        (Parcel("box", **box),),
    )


def limits(scenario):
    return parcel_limits(scenario, scenario.parcel[0])


@pytest.mark.parametrize(
    ("resistance_ohm", "rolling", "sliding", "rolling_equilibrium"),
    [(4.0, 0.06346, 0.2076, 0.1454), (5.0, 0.0793, 0.2596, 0.1817)],
)
def test_paper_bounds_need_4_ohm(resistance_ohm, rolling, sliding, rolling_equilibrium):
    found = limits(paper(resistance_ohm))
    assert found.rolling_max_m_s == pytest.approx(rolling, abs=5e-5)
    assert found.sliding_min_m_s == pytest.approx(sliding, abs=5e-5)
    assert found.rolling_equilibrium_max_m_s == pytest.approx(rolling_equilibrium, abs=5e-5)
    assert (found.supports_min, found.supports_max) == (3, 4)


@given(pitches=st.floats(2.0, 9.0))
def test_eqs_2_and_3_bound_the_loads_in_every_position(pitches):
    """Brute force over positions of the parcel on an endless row."""
    m, h = whole_pitches(pitches)
    wheels = np.arange(-m - 3, m + 4)
    edge = pitches / 2
    turning = np.array([(w + s * edge) % 1.0 for w in (0, 1) for s in (-1, 1)])
    positions = np.concatenate([np.linspace(0, 1, 41), turning - 1e-9, turning + 1e-9])
    least, most = np.inf, 0.0
    for x in positions:
        places = wheels[abs(wheels - x) <= edge]
        matrix = np.array([np.ones(len(places)), places])
        loads = matrix.T @ np.linalg.solve(matrix @ matrix.T, [1.0, x])
        least, most = min(least, loads.min()), max(most, loads.max())
    assert normal_min_n(pitches, 1.0) <= least + 1e-12
    assert normal_max_n(pitches, 1.0) >= most - 1e-12
    if 1e-6 < h < 1 - 1e-6:
        assert least == pytest.approx(normal_min_n(pitches, 1.0), abs=1e-7)
        assert most == pytest.approx(normal_max_n(pitches, 1.0), abs=1e-7)


def test_search_finds_the_paper_bounds_when_its_shortcut_does_not_apply():
    centred, shifted = limits(paper()), limits(paper(centre_of_mass_m=(1e-9, 0.0)))
    assert shifted.normal_min_n == pytest.approx(centred.normal_min_n, rel=0.03)
    assert shifted.normal_max_n == pytest.approx(centred.normal_max_n, rel=0.03)
    assert shifted.sliding_min_m_s == pytest.approx(centred.sliding_min_m_s, rel=1e-6)
    assert (shifted.supports_min, shifted.supports_max) == (3, 4)


def test_just_below_eq_14_the_worst_case_of_eq_13_rolls():
    scenario = paper()
    drive, found = drive_of(scenario.cell), limits(scenario)
    for factor, expected in ((0.999, True), (1.001, False)):
        reference = factor * rolling_max_m_s(drive, 0.3, found.normal_min_n)
        assert rolls(drive, 0.3, found.normal_min_n, reference, -reference) is expected


def test_two_wheels_a_cell_share_the_weight_in_the_plane():
    wheels = (Wheel(0.0, (-0.03, 0.0)), Wheel(np.pi / 2, (0.03, 0.0)))
    scenario = Scenario("p", Array(6, 3), Cell(wheel=wheels), (Parcel("box", 2.0, 0.36, 0.30),))
    found = limits(scenario)
    loads = normals_at(scenario, scenario.parcel[0], 0.02, 0.01)
    assert loads.sum() == pytest.approx(2.0 * 9.81)
    assert found.normal_min_n <= loads[loads > 0].min()
    assert found.normal_max_n >= loads.max()
    assert found.supports_max > found.supports_min >= 3


def test_a_parcel_that_tips_everywhere_has_no_bounds():
    with pytest.raises(ScenarioError, match="tips wherever it lies"):
        limits(paper(length_m=0.1))
