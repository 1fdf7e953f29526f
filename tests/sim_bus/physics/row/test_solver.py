from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mdms_model.array import build_wheels
from mdms_model.motor import drive_of
from mdms_model.run.record import Contact
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.motion import Motion
from mdms_model.scenario.scenario import (
    Array,
    Cell,
    Parcel,
    Patch,
    Run,
    Scenario,
    ScenarioError,
    Wheel,
)
from mdms_sim.physics.row.solver import solve_row
from mdms_sim.physics.row.trace import row_parcel

PITCH_M = 0.127
BOX = Parcel("box", mass_kg=2.0, length_m=0.4445, width_m=0.1, x_m=-0.34925)


def row(*parcels, duration_s=20.0, step_s=0.01, speed_m_s=0.0635, cell=None, columns=10):
    return Scenario(
        "row",
        Array(columns, 1, PITCH_M),
        cell or Cell(),
        parcels or (BOX,),
        Motion("inward", speed_m_s),
        Run("row", duration_s, step_s),
    )


def inward(scenario):
    return -np.sign(build_wheels(scenario).position_m[:, 0]) * scenario.motion.speed_m_s


def solve(scenario, reference_m_s=None):
    return solve_row(scenario, inward(scenario) if reference_m_s is None else reference_m_s)


def paper(figure):
    return load_scenario(f"paper-fig{figure}")


def turns(record):
    """Places of the centre at the reversals, and their times."""
    times_s = np.array([event.time_s for event in record.events if event.kind == "reversal"])
    return record.pose[np.searchsorted(record.time_s, times_s), 0, 0], times_s


def test_fig7_parcel_rolls_to_rest_just_after_touching_second_cell():
    record = solve(paper(7))
    assert record.pose[-1, 0, 0] == pytest.approx(-0.0308531, abs=1e-6)
    touch = [event for event in record.events if event.kind == "support" and event.cell == 7]
    assert [event.detail for event in touch] == ["takes load"]
    assert touch[0].time_s == pytest.approx(10.305, abs=5e-4)
    assert not np.isin(record.contact, (Contact.SLIDING_FORWARD, Contact.SLIDING_BACKWARD)).any()
    assert not [event for event in record.events if event.kind == "reversal"]


def test_fig8_parcel_swings_for_ever_with_the_same_amplitude_and_period():
    record = solve(paper(8))
    places_m, times_s = turns(record)
    assert abs(places_m) == pytest.approx(0.34925, abs=1e-12)
    assert 2 * np.diff(times_s) == pytest.approx(1.99042, abs=1e-5)
    assert not (record.contact == Contact.ROLLING).any()


def test_fig9_parcel_swings_down_with_the_known_peaks():
    places_m, _ = turns(solve(paper(9)))
    assert places_m[:4] == pytest.approx([0.1134, -0.1042, 0.0997, -0.0965], abs=1e-4)


@given(
    speeds=st.lists(st.floats(-3.0, 3.0), min_size=10, max_size=10),
    friction=st.floats(0.0, 1.0),
    pitches=st.floats(2.0, 6.0),
    offset=st.floats(-0.2, 0.2),
)
def test_friction_and_contact_obey_their_laws(speeds, friction, pitches, offset):
    # Between 3 or 5 wheels exactly it may be held at both ends at once: forces are then a mean of
    # those with and without the outermost wheels, which no state of a contact describes.
    assume(pitches % 2 != 1.0)
    length_m = pitches * PITCH_M
    parcel = Parcel("p", 2.0, length_m, 0.1, centre_of_mass_m=(offset * length_m, 0.0))
    scenario = row(parcel, duration_s=2.0, cell=Cell(friction=friction))
    record = solve(scenario, np.array(speeds))
    carried = record.contact != Contact.NONE
    upright = carried.any(axis=1)
    slip = record.speed_m_s - record.twist[:, :1, 0]
    ahead = record.contact == Contact.SLIDING_FORWARD
    back = record.contact == Contact.SLIDING_BACKWARD
    limit_n = friction * record.normal_n
    assert record.normal_n.min() >= -1e-9
    assert record.normal_n[upright].sum(axis=1) == pytest.approx(2.0 * 9.81)
    assert (abs(record.force_n) <= limit_n + 1e-9).all()
    assert record.force_n[ahead] == pytest.approx(limit_n[ahead], abs=1e-9)
    assert record.force_n[back] == pytest.approx(-limit_n[back], abs=1e-9)
    assert (slip[ahead] >= -1e-9).all()
    assert (slip[back] <= 1e-9).all()
    assert slip[record.contact == Contact.ROLLING] == pytest.approx(0.0, abs=1e-9)
    assert not record.force_n[~carried].any()


@given(speeds=st.lists(st.floats(-1.0, 1.0), min_size=10, max_size=10), part=st.floats(-0.2, 0.2))
def test_mirrored_row_moves_as_the_mirror_image(speeds, part):
    scenario = row(replace(BOX, x_m=part), duration_s=1.5)
    mirrored = row(replace(BOX, x_m=-part), duration_s=1.5)
    record = solve(scenario, np.array(speeds))
    image = solve(mirrored, -np.array(speeds[::-1]))
    ends = [np.interp(1.5, each.time_s, each.pose[:, 0, 0]) for each in (record, image)]
    if record.time_s[-1] == image.time_s[-1] == 1.5:
        assert ends[0] == pytest.approx(-ends[1], abs=1e-8)


def test_uniform_field_accelerates_by_friction_and_then_exponentially():
    scenario = row(Parcel("p", 2.0, 0.4, 0.1, -2.0), duration_s=2.0, columns=60)
    drive, reference = drive_of(scenario.cell), 2.0
    record = solve(scenario, np.full(60, reference))
    speed, time_s = record.twist[:, 0, 0], record.time_s
    assert np.isin(record.contact[0], (Contact.NONE, Contact.SLIDING_FORWARD)).all()
    sliding = ~(record.contact == Contact.ROLLING).any(axis=1)
    assert speed[sliding] == pytest.approx(0.3 * 9.81 * time_s[sliding], abs=1e-12)
    rolling = ~(record.contact >= Contact.SLIDING_FORWARD).any(axis=1)
    assert speed[rolling][-1] == pytest.approx(drive.droop * reference, rel=1e-9)
    gap = drive.droop * reference - speed
    supports = (record.contact == Contact.ROLLING).sum(axis=1)
    decay = np.diff(np.log(gap)) / np.diff(time_s)
    within = rolling[:-1] & rolling[1:] & (supports[:-1] == supports[1:]) & (gap[1:] > 1e-6)
    rate = drive.b * supports[:-1][within] / 2.0
    assert within.sum() > 20
    assert -decay[within] == pytest.approx(rate, rel=1e-6)


def test_two_parcels_move_as_each_would_alone():
    left, right = Parcel("l", 1.0, 0.3, 0.1, -0.4), Parcel("r", 3.0, 0.3, 0.1, 0.4)
    reference = np.array([0.5, 0.2, 0.1, -0.3, 0.0, 0.0, 0.1, 0.3, -0.2, -0.4])
    both = solve(row(left, right, duration_s=2.0), reference)
    for number, parcel in enumerate((left, right)):
        alone = solve(row(parcel, duration_s=2.0), reference)
        at = np.searchsorted(both.time_s, alone.time_s)
        assert both.pose[at, number] == pytest.approx(alone.pose[:, 0], abs=1e-12)
    assert both.normal_n[-1].sum() == pytest.approx(4.0 * 9.81)
    assert {event.parcel for event in both.events} == {"l", "r"}


def test_parcels_that_would_touch_are_refused():
    left, right = Parcel("l", 1.0, 0.3, 0.1, -0.3), Parcel("r", 1.0, 0.3, 0.1, 0.3)
    with pytest.raises(ScenarioError, match=r"'l' and 'r' touch at 3\.\d+ s"):
        solve(row(left, right, duration_s=20.0))


def test_parcel_tips_where_its_centre_of_mass_leaves_the_last_wheel():
    record = solve(row(replace(BOX, x_m=0.0), duration_s=20.0), np.full(10, 0.2))
    tip = record.events[-1]
    assert (tip.kind, tip.parcel) == ("tip", "box")
    assert record.time_s[-1] == tip.time_s < 10.0
    assert record.pose[-1, 0, 0] == pytest.approx(4.5 * PITCH_M, abs=1e-12)
    assert [event.kind for event in record.events].count("tip") == 1


@pytest.mark.parametrize(
    "parcel",
    [
        Parcel("beside", 1.0, 0.4, 0.1, y_m=0.06),
        Parcel("short", 1.0, 0.1, 0.1),
        Parcel("heavy at its end", 1.0, 0.27, 0.1, x_m=0.01, centre_of_mass_m=(0.134, 0.0)),
    ],
)
def test_parcel_without_supports_around_its_centre_of_mass_tips_at_once(parcel):
    record = solve(row(parcel))
    assert record.time_s.tolist() == [0.0]
    assert [event.kind for event in record.events] == ["tip"]


def test_parcel_of_whole_pitches_is_held_where_its_ends_are_over_wheels():
    """Three supports push it towards the middle from both sides; only there it touches a fourth."""
    record = solve(row(Parcel("p", 2.0, 3 * PITCH_M, 0.1, -0.05), duration_s=20.0))
    assert record.pose[-1, 0, 0] == pytest.approx(0.0, abs=1e-9)
    assert record.twist[-1, 0, 0] == 0.0
    assert record.force_n[-1].sum() == pytest.approx(0.0, abs=1e-12)
    assert (record.contact[-1] == Contact.ROLLING).sum() == 4
    assert record.normal_n[-1].sum() == pytest.approx(2.0 * 9.81)
    assert record.events[-1].detail.startswith("rests on an edge")


@pytest.mark.parametrize("speed_m_s", [0.0635, 1.0])
def test_parcel_placed_on_that_edge_stays_by_symmetry(speed_m_s):
    """Rolling wheels push it back to the middle, sliding ones away from it."""
    parcel = Parcel("p", 2.0, 3 * PITCH_M, 0.1)
    record = solve(row(parcel, duration_s=1.0, speed_m_s=speed_m_s))
    assert not record.pose[:, 0, 0].any()
    assert record.normal_n[-1] == pytest.approx(record.normal_n[-1, ::-1])
    assert record.force_n[-1] == pytest.approx(-record.force_n[-1, ::-1])


def test_disc_covers_less_of_a_row_beside_its_middle():
    disc = Parcel("disc", 2.0, 0.4445, 0.4445, y_m=0.16, shape="disc")
    chord_m = 2 * np.sqrt((0.4445 / 2) ** 2 - 0.16**2)
    row_of = {
        name: row_parcel(row(parcel), parcel, np.zeros(10))
        for name, parcel in {
            "disc": disc,
            "bar": Parcel("bar", 2.0, chord_m, 0.1),
            "diamond": Parcel(
                "diamond",
                2.0,
                2 * chord_m,
                0.2,
                y_m=-0.05,
                shape="polygon",
                corners_m=((chord_m, 0.0), (0.0, 0.1), (-chord_m, 0.0), (0.0, -0.1)),
            ),
        }.items()
    }
    for other in ("bar", "diamond"):
        assert row_of["disc"].edge_m == pytest.approx(row_of[other].edge_m, abs=1e-12)
        assert (row_of["disc"].first == row_of[other].first).all()


def test_patch_of_slippery_cells_pushes_less():
    slippery = replace(row(speed_m_s=2.0), patch=(Patch(cells=(3, 4), friction=0.1),))
    record = solve(slippery)
    grip = record.force_n[0, [2, 3]] / record.normal_n[0, [2, 3]]
    assert grip == pytest.approx(0.1)


def test_parcel_without_friction_stays():
    record = solve(row(cell=Cell(friction=0.0), speed_m_s=0.5, duration_s=1.0))
    assert record.pose[:, 0, 0] == pytest.approx(-0.34925, abs=1e-12)


def test_samples_stand_at_every_step_and_every_event():
    scenario = row(duration_s=3.0, step_s=0.25)
    record = solve(scenario)
    events_s = {event.time_s for event in record.events}
    assert record.time_s.tolist() == sorted(set(np.arange(13) * 0.25) | events_s)
    assert len(events_s) == 2


def test_free_wheels_turn_with_the_droop_and_voltage_drives_them():
    scenario = row(duration_s=0.1)
    record, drive = solve(scenario), drive_of(scenario.cell)
    free = record.contact == Contact.NONE
    assert record.speed_m_s[free] == pytest.approx(drive.droop * record.reference_m_s[free])
    expected_v = 10.0 * (record.reference_m_s - record.speed_m_s)
    assert record.voltage_v == pytest.approx(expected_v)


@pytest.mark.parametrize(
    ("scenario", "key"),
    [
        (replace(row(), array=Array(6, 3)), "array.rows is 3"),
        (row(cell=Cell(wheel=(Wheel(), Wheel(1.57)))), "number of wheels in a cell is 2"),
        (row(cell=Cell(wheel=(Wheel(1.57),))), "direction is 0.0007"),
        (row(cell=Cell(viscous_friction_s_per_m=1.0)), "viscous_friction_s_per_m is 1.0"),
        (row(replace(BOX, yaw_rad=0.1)), "parcel.0.yaw_rad is 0.1"),
    ],
)
def test_a_scenario_that_is_no_row_is_refused(scenario, key):
    with pytest.raises(ScenarioError, match=key):
        solve_row(scenario, np.zeros(scenario.array.columns * scenario.array.rows))


def test_run_with_more_events_than_can_be_kept_is_refused():
    endless = replace(paper(8), run=replace(paper(8).run, duration_s=1e5, step_s=1.0))
    with pytest.raises(ScenarioError, match=r"1000000 events in .* take a shorter run.duration_s"):
        solve(endless)
