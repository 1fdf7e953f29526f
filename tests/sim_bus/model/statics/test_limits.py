from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mdms_model.array import lay_out
from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Array, Cell, Parcel, Scenario, ScenarioError, Wheel
from mdms_model.statics.limits import (
    normal_max_n,
    normal_min_n,
    parcel_limits,
    rolling_max_m_s,
    rolls,
    whole_pitches,
)
from mdms_model.statics.normal_bounds import centred_normal_n, search_normals

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


@given(pitches=st.floats(2.01, 9.0))
def test_search_along_a_row_finds_eqs_2_and_3(pitches):
    _, h = whole_pitches(pitches)
    assume(1e-6 < h < 1 - 1e-6)
    scenario = paper(length_m=pitches * PITCH_M)
    found = search_normals(scenario, scenario.parcel[0])
    weight_n = 2.0 * 9.81
    assert found.normal_min_n == pytest.approx(normal_min_n(pitches, weight_n), abs=1e-6)
    assert found.normal_max_n == pytest.approx(normal_max_n(pitches, weight_n), abs=1e-6)
    assert (found.supports_min, found.supports_max) == (int(pitches), int(pitches) + 1)


def test_shifted_centre_of_mass_widens_the_bounds():
    centred, shifted = limits(paper()), limits(paper(centre_of_mass_m=(0.03, 0.0)))
    assert shifted.normal_min_n < centred.normal_min_n
    assert shifted.normal_max_n > centred.normal_max_n


def test_shifting_the_origin_onto_a_cell_changes_the_wheels_that_slide_at_equilibrium():
    """Three wheels under a centred parcel instead of four, each with a third of the weight."""
    odd = replace(paper(), array=Array(9, 1, PITCH_M))
    assert limits(odd).sliding_min_m_s == pytest.approx(limits(paper()).sliding_min_m_s * 4 / 3)


def test_just_below_eq_14_the_worst_case_of_eq_13_rolls():
    scenario = paper()
    drive, found = drive_of(scenario.cell), limits(scenario)
    for factor, expected in ((0.999, True), (1.001, False)):
        reference = factor * rolling_max_m_s(drive, 0.3, found.normal_min_n)
        assert rolls(drive, 0.3, found.normal_min_n, reference, -reference) is expected


TWO_WHEELS = (Wheel(0.0, (-0.03, 0.0)), Wheel(np.pi / 2, (0.03, 0.0)))


def plane(parcel, wheels=TWO_WHEELS):
    return Scenario("plane", Array(6, 3), Cell(wheel=wheels), (parcel,))


def wheels_around(scenario):
    """Where the wheels of cells in all directions are."""
    steps = np.arange(-5, 6) * PITCH_M
    centres = np.array([(x, y) for x in steps for y in steps])
    return lay_out(centres, [scenario.cell] * len(centres)).position_m


def loads_by_least_squares(scenario, wheels_m, x_m, y_m, yaw_rad):
    """Loads of the wheels under the parcel, or None where one would pull or it tips."""
    parcel = scenario.parcel[0]
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    own_m = (wheels_m - (x_m, y_m)) @ np.array([[cosine, -sine], [sine, cosine]])
    if parcel.shape == "disc":
        under = np.hypot(*own_m.T) <= parcel.length_m / 2
    else:
        under = (abs(own_m) <= (parcel.length_m / 2, parcel.width_m / 2)).all(axis=1)
    spots_m = own_m[under] - parcel.centre_of_mass_m
    matrix = np.vstack([np.ones(len(spots_m)), spots_m.T])
    loads, *_ = np.linalg.lstsq(matrix, [parcel.mass_kg * 9.81, 0.0, 0.0], rcond=None)
    balanced = abs(matrix @ loads - [parcel.mass_kg * 9.81, 0.0, 0.0]).max() < 1e-9
    return loads if balanced and loads.min() >= 0.0 else None


@pytest.mark.parametrize(
    "parcel",
    [
        Parcel("box", 2.0, 0.36, 0.30),
        Parcel("long", 1.0, 0.60, 0.28, centre_of_mass_m=(0.02, -0.01)),
        Parcel("disc", 2.0, 0.40, 0.40, shape="disc"),
    ],
)
def test_bounds_in_the_plane_hold_in_random_poses_and_are_nearly_reached(parcel):
    scenario = plane(parcel)
    found = search_normals(scenario, parcel)
    chance = np.random.default_rng(7)
    poses = chance.uniform([-0.5, -0.5, -30.0], [0.5, 0.5, 30.0], (3000, 3)) * (PITCH_M, PITCH_M, 1)
    wheels_m = wheels_around(scenario)
    loads = [loads_by_least_squares(scenario, wheels_m, *pose) for pose in poses]
    standing = [each for each in loads if each is not None]
    least, most = min(each.min() for each in standing), max(each.max() for each in standing)
    assert found.normal_min_n <= least + 1e-6
    assert most - 1e-6 <= found.normal_max_n <= 1.25 * most
    assert found.normal_min_n == pytest.approx(least, abs=0.1 * most)
    assert found.supports_min <= min(map(len, standing))
    assert found.supports_max >= max(map(len, standing))


def test_parcel_at_the_origin_loads_its_wheels_by_least_squares():
    parcel = Parcel("box", 2.0, 0.36, 0.30, yaw_rad=0.2)
    scenario = plane(parcel)
    loads = loads_by_least_squares(scenario, wheels_around(scenario), PITCH_M / 2, 0.0, 0.2)
    assert centred_normal_n(scenario, parcel) == pytest.approx(loads.max())


def test_a_parcel_that_tips_everywhere_has_no_bounds():
    with pytest.raises(ScenarioError, match="tips wherever it lies"):
        limits(paper(length_m=0.1))
