"""The host is told the facts of the scenario, and no more."""

from dataclasses import replace

import numpy as np
import pytest

from mdms_array.checks import goal_of
from mdms_array.host import (
    coordinator_of,
    estimates_of,
    layout_of,
    parcels_of,
    references_m_s,
    settings_of,
)
from mdms_array.simulation import run_scenario
from mdms_host.can_link.sdo_client import Setting
from mdms_host.estimation.footprint import Disc, Polygon
from mdms_host.motion.footholds import Footholds
from mdms_model.array import build_wheels
from mdms_model.errors import InputError
from mdms_model.fields import FieldError
from mdms_model.scenario.file import load_scenario
from mdms_protocol.dictionary import ENTRIES


@pytest.fixture
def plane():
    return load_scenario("array18")


def test_belief_of_the_host_is_where_the_wheels_are(plane):
    layout, wheels = layout_of(plane), build_wheels(plane)
    np.testing.assert_allclose(layout.wheel_positions_m, wheels.position_m)
    np.testing.assert_allclose(layout.wheel_directions, wheels.direction, atol=1e-15)
    np.testing.assert_array_equal(layout.wheel_cells, wheels.cell + 1)


def test_prototype_is_at_the_defaults_of_the_firmware_but_for_the_gain(plane):
    told = {each.index: each.value for each in settings_of(plane.cell)}
    defaults = {index: ENTRIES[index, 0].default for index in told}
    assert told == {**defaults, 0x2000: 10_000, 0x2800: 10_000}


@pytest.mark.parametrize(
    ("rotor_inertia_kg_m2", "told"), [(2e-6, 20_053), (4e-6, 13_607), (1e-9, 38_083)]
)
def test_cells_get_settings_that_suit_the_inertia_of_their_wheels(plane, rotor_inertia_kg_m2, told):
    cell = replace(plane.cell, rotor_inertia_kg_m2=rotor_inertia_kg_m2)
    assert settings_of(cell)[3] == Setting(0x200A, 0, told)


def test_cells_are_told_nothing_of_wheels_without_inertia_and_no_more_than_they_take(plane):
    massless = replace(plane.cell, rotor_inertia_kg_m2=0.0, wheel_inertia_kg_m2=0.0)
    light = replace(plane.cell, rotor_inertia_kg_m2=1e-9, wheel_inertia_kg_m2=0.0)
    assert settings_of(massless)[3] == Setting(0x200A, 0, 0)
    assert settings_of(light)[3] == Setting(0x200A, 0, 65_535)


def test_the_host_writes_its_settings_to_both_axes(plane):
    cell = replace(plane.cell, gain_vs_per_m=7.5, supply_v=12.0)
    assert settings_of(cell) == (
        Setting(0x2000, 0, 7500),
        Setting(0x2001, 0, ENTRIES[0x2001, 0].default),
        Setting(0x2002, 0, 12000),
        Setting(0x200A, 0, 20053),
        Setting(0x2800, 0, 7500),
        Setting(0x2801, 0, ENTRIES[0x2001, 0].default),
        Setting(0x2802, 0, 12000),
        Setting(0x280A, 0, 20053),
        Setting(0x3003, 0, 6000),
    )


def test_resolution_is_counts_per_metre_of_surface(plane):
    cell = replace(plane.cell, encoder_counts_per_motor_rev=1000)
    counts_per_m = 1000 * 3.0 / (2 * np.pi * 0.0254)
    assert settings_of(cell)[1] == Setting(0x2001, 0, int(counts_per_m))


def test_gain_beyond_the_firmware_is_refused(plane):
    with pytest.raises(InputError, match=r"cell.gain_vs_per_m does not fit the firmware"):
        settings_of(replace(plane.cell, gain_vs_per_m=101.0))


def test_nothing_is_believed_before_the_first_frame(plane):
    assert np.isnan(estimates_of(coordinator_of(plane), plane)).all()


def test_several_parcels_are_told_apart_by_where_they_were_put(plane):
    box = replace(plane.parcel[0], length_m=0.2, x_m=-0.2)
    two = replace(plane, parcel=(box, replace(box, name="other", x_m=0.2, goal=None)))
    assert [parcel.near_m for parcel in parcels_of(two)] == [(-0.2, 0.0), (0.2, 0.0)]


def test_field_is_played_on_every_wheel():
    row = load_scenario("paper-fig7")
    expected = np.repeat([0.0635, -0.0635], 5)
    np.testing.assert_allclose(references_m_s(row), expected)


def test_every_field_of_a_scenario_gives_a_reference_per_wheel(plane):
    kinds = ("inward", "uniform", "rotate", "elliptic", "twist", "squeeze")
    for field in (*kinds, "linear", "lane", "diverter"):
        motion = replace(
            plane.motion,
            field=field,
            speed_m_s=0.1,
            velocity_m_s=(0.1, 0.0),
            ratio=0.3,
            width_m=0.2,
        )
        references = references_m_s(replace(plane, motion=motion))
        assert references.shape == (36,)
        assert np.abs(references).max() == pytest.approx(0.1, rel=0.35)


def test_bad_table_is_refused_by_its_key(plane):
    motion = replace(plane.motion, field="table", table_m_s=(0.1,))
    with pytest.raises(FieldError, match=r"motion.field: the table"):
        references_m_s(replace(plane, motion=motion))


def test_discs_and_polygons_are_handed_on_as_such(plane):
    corners_m = ((0.17, -0.15), (0.0, 0.15), (-0.17, -0.15))
    (box,) = plane.parcel
    disc = replace(box, shape="disc", length_m=0.3, width_m=0.3)
    triangle = replace(box, name="triangle", shape="polygon", corners_m=corners_m)
    told = parcels_of(replace(plane, parcel=(disc, triangle)))
    assert told[0].footprint == Disc(0.3)
    assert told[1].footprint == Polygon(corners_m)


def test_a_disc_is_steered_to_a_place_however_it_is_turned(plane):
    (box,) = plane.parcel
    disc = replace(box, shape="disc", length_m=0.3, width_m=0.3)
    told = goal_of(replace(disc, goal=replace(box.goal, yaw_rad=0.0)))
    assert (told.x_m, told.y_m, told.yaw_rad) == (0.10, 0.0, None)
    with pytest.raises(InputError, match=r"goal.yaw_rad of parcel 'box' is 0.523.*leave yaw_rad"):
        goal_of(disc)


@pytest.mark.parametrize("field", ["goal", "program"])
def test_cells_are_led_by_where_the_centre_of_mass_is(monkeypatch, field):
    centres_m = set()

    class Noted(Footholds):
        def __init__(self, layout, footprint, centre_of_mass_m):
            centres_m.add(tuple(centre_of_mass_m))
            super().__init__(layout, footprint, centre_of_mass_m)

    monkeypatch.setattr("mdms_host.motion.by_cells.program.Footholds", Noted)
    keys = [
        "motion.control='cells'",
        "motion.speed_m_s=0.2",
        "parcel.0.centre_of_mass_m=[0.02, 0.01]",
        "run.duration_s=1.0",
    ]
    if field == "program":
        task = "task=[{do='transport', parcel='box', x_m=0.1, y_m=0.0}]"
        keys += ["motion.field='program'", task]
    run_scenario(load_scenario("array18", keys))
    assert centres_m == {(0.02, 0.01)}
