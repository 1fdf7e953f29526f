"""Pictures show the content of the record: traces, bands, footprints, goals."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb

from mdms_model.outline import outline_m
from mdms_model.run.colours import parcel_colour
from mdms_model.run.record import Contact, Event, Record
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Parcel, Stream
from mdms_sim.physics.row.solver import solve_row
from mdms_sim.plots import drawable, is_row, save_picture, save_wheels
from mdms_sim.plots.plane import draw_plane
from mdms_sim.plots.row import BANDS, draw_row
from mdms_sim.plots.top_view import slip_share
from mdms_sim.plots.wheels import draw_wheels


@pytest.fixture
def row():
    return load_scenario("paper-fig7")


@pytest.fixture
def row_record(row):
    """The box glides from left to right; cell 1 rolls, then slides, then is free."""
    samples, cells = 31, row.array.columns
    time_s = np.linspace(0.0, 3.0, samples)
    pose = np.zeros((samples, 1, 3))
    pose[:, 0, 0] = np.linspace(-0.35, 0.2, samples)
    contact = np.zeros((samples, cells), dtype=np.int8)
    contact[:10, 0] = Contact.ROLLING
    contact[10:20, 0] = Contact.SLIDING_FORWARD
    numbers = np.zeros((samples, cells))
    return Record(time_s, pose, np.gradient(pose, time_s, axis=0), *[numbers] * 5, contact)


def text_of(figure):
    return " ".join(text.get_text() for text in figure.texts)


def test_row_has_three_traces_half_a_length_apart(row, row_record):
    axes = draw_row(row, row_record).axes[0]
    low, high, middle = sorted(
        (line.get_ydata() for line in axes.lines), key=lambda trace: trace[0] == -0.35
    )
    np.testing.assert_allclose(middle, row_record.pose[:, 0, 0])
    np.testing.assert_allclose(middle - low, row.parcel[0].length_m / 2)
    np.testing.assert_allclose(high - middle, row.parcel[0].length_m / 2)


def bands_of_cell(axes, place_m):
    """(start, end, colour) of the bands at one height."""
    bands = []
    for collection in axes.collections:
        for path in collection.get_paths():
            box = path.get_extents()
            if box.y0 < place_m < box.y1:
                bands.append((box.x0, box.x1, to_hex(collection.get_facecolor()[0])))
    return [
        (round(start_s, 9), round(end_s, 9), colour) for start_s, end_s, colour in sorted(bands)
    ]


def test_row_bands_follow_the_contact(row, row_record):
    axes = draw_row(row, row_record).axes[0]
    first = -4.5 * row.array.pitch_m
    assert bands_of_cell(axes, first) == [
        (0.0, 1.0, BANDS["rolling"]),
        (1.0, 2.0, BANDS["sliding"]),
        (2.0, 3.0, BANDS["no contact"]),
    ]
    assert len(bands_of_cell(axes, -first)) == 1


def test_bands_grow_darker_as_in_the_paper():
    light, medium, dark = (
        sum(to_rgb(BANDS[name])) for name in ("no contact", "sliding", "rolling")
    )
    assert light > medium > dark


def test_wheel_that_slipped_half_the_time_has_half_a_share():
    contact = np.array([[1, 0, 2], [3, 0, 2], [0, 0, 1], [0, 0, 1]], dtype=np.int8)
    np.testing.assert_array_equal(slip_share(contact), [0.5, np.nan, 0.5])


def same_corners(shape, wanted):
    return sorted(shape.round(9).tolist()) == sorted(wanted.round(9).tolist())


def test_plane_shows_the_last_footprint_and_the_goal(plane, plane_record):
    view = draw_plane(plane, plane_record).axes[0]
    parcel = plane.parcel[0]
    outlines = [patch.get_xy()[:4] for patch in view.patches if hasattr(patch, "get_closed")]
    for pose in (plane_record.pose[0, 0], plane_record.pose[-1, 0], (0.1, 0.0, 0.5235987755982988)):
        wanted = outline_m(np.array(pose), parcel)
        assert any(same_corners(shape, wanted) for shape in outlines)


def test_plane_view_holds_all_footprints(plane, plane_record):
    gone = replace(plane_record, pose=plane_record.pose + np.array([0.5, 0, 0]))
    view = draw_plane(plane, gone).axes[0]
    assert view.get_xlim()[1] > 0.6
    assert view.get_aspect() == 1.0


def test_plane_tells_how_far_off_the_goal(plane, plane_record):
    plane_record.pose[-1, 0, 0] += 0.005
    assert "5.0 mm and 0.0° off its goal" in text_of(draw_plane(plane, plane_record))


def test_plane_tells_of_a_tip(plane, plane_record):
    plane_record.events.append(Event(3.5, "tip", "left the supports", parcel="box"))
    assert "tipped off at 3.50 s" in text_of(draw_plane(plane, plane_record))


def panel(figure, name):
    (axes,) = (axes for axes in figure.axes if axes.get_ylabel() == name)
    return axes


def test_panels_show_truth_and_goal(plane, plane_record):
    yaw = panel(draw_plane(plane, plane_record), "yaw [°]")
    true, goal = (line.get_ydata() for line in yaw.lines)
    np.testing.assert_allclose(true, np.degrees(plane_record.pose[:, 0, 2]))
    assert goal[0] == pytest.approx(30.0)


def test_goal_is_drawn_in_the_turn_that_the_parcel_has_made(plane, plane_record):
    plane_record.pose[:, 0, 2] -= 2 * np.pi
    yaw = panel(draw_plane(plane, plane_record), "yaw [°]")
    assert yaw.lines[1].get_ydata()[0] == pytest.approx(-330.0)


def test_belief_against_truth_is_in_millimetres_and_degrees(plane, plane_record):
    plane_record.estimate[:, 0, 2] -= 2 * np.pi
    figure = draw_plane(plane, plane_record)
    away = panel(figure, "belief off by [mm]").lines[0].get_ydata()
    turn = panel(figure, "belief off by [°]").lines[0].get_ydata()
    np.testing.assert_allclose(away[5:], 2**0.5)
    np.testing.assert_allclose(turn[5:], np.degrees(0.001))
    assert np.isnan(away[:5]).all()


def test_one_sample_far_out_does_not_set_the_scale_and_is_marked(plane, plane_record):
    time_s = np.linspace(0.0, 4.0, 401)
    pose = np.zeros((401, 1, 3))
    pose[:, 0, 0] = 0.1 * time_s
    estimate = pose + np.array([0.001, 0.0, 0.0])
    estimate[200, 0, 0] += 0.5
    wheels = np.zeros((401, 36))
    names = ("reference_m_s", "speed_m_s", "voltage_v", "normal_n", "force_n")
    record = replace(
        plane_record,
        **{"time_s": time_s, "pose": pose, "twist": pose, "estimate": estimate},
        **dict.fromkeys(names, wheels),
        contact=wheels.astype(np.int8),
    )
    axes = panel(draw_plane(plane, record), "belief off by [mm]")
    assert axes.get_ylim()[1] < 5.0
    mark = axes.lines[-1]
    assert (mark.get_xdata()[0], mark.get_marker()) == (pytest.approx(2.0), "^")
    assert "501" in [text.get_text() for text in axes.texts]


def test_time_ends_when_nothing_moves_any_more(plane, plane_record):
    still = np.tile(plane_record.pose[-1:], (60, 1, 1))
    pose = np.concatenate((plane_record.pose, still))
    time_s = np.linspace(0.0, 10.0, len(pose))
    long = replace(
        plane_record,
        **{"time_s": time_s, "pose": pose, "twist": pose, "estimate": None},
        **{
            name: np.zeros((len(pose), 36))
            for name in ("reference_m_s", "speed_m_s", "voltage_v", "normal_n", "force_n")
        },
        contact=np.zeros((len(pose), 36), np.int8),
    )
    yaw = panel(draw_plane(plane, long), "yaw [°]")
    # It moves for 3 s of 4 s, at ten samples in 0.99 s.
    assert 3.0 < yaw.get_xlim()[1] < 4.0
    assert yaw.get_xlabel().endswith("at rest until 10 s")


def test_outlines_on_the_way_have_their_times(plane, plane_record):
    figure = draw_plane(plane, plane_record)
    told = [text.get_text() for text in figure.axes[0].texts if text.get_text().endswith(" s")]
    assert told[0] == "0.0 s"
    assert told[-1] == "3.0 s"
    assert len(told) == 6


def test_every_parcel_is_named_where_it_is_and_in_the_legend(plane, plane_record):
    box = plane.parcel[0]
    many = tuple(replace(box, name=f"box {number}") for number in range(9))
    record = replace(
        plane_record,
        **{
            name: np.tile(getattr(plane_record, name), (1, 9, 1))
            for name in ("pose", "twist", "estimate")
        },
    )
    figure = draw_plane(replace(plane, parcel=many), record)
    names = {parcel.name for parcel in many}
    assert names <= {text.get_text() for text in figure.axes[0].texts}
    assert names <= {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    renderer = figure.canvas.get_renderer()
    covered = [legend.get_window_extent(renderer) for legend in figure.legends]
    assert not any(box.overlaps(axes.bbox) for box in covered for axes in figure.axes)


def test_long_table_has_the_whole_width_and_panels_below(plane, plane_record):
    figure = draw_plane(plane, plane_record)
    beside = figure.axes[0].get_position()
    wide = replace(plane, array=replace(plane.array, columns=12))
    record = replace(
        plane_record,
        estimate=None,
        contact=np.zeros((41, 72), np.int8),
        speed_m_s=np.zeros((41, 72)),
    )
    table, *panels = draw_plane(wide, record).axes
    assert beside.x1 < 0.65
    assert table.get_position().x1 > 0.95
    assert all(
        axes.get_position().y1 < table.get_position().y0 for axes in panels if axes.get_ylabel()
    )


def test_colours_of_neighbouring_parcels_differ():
    assert len({parcel_colour(number) for number in range(12)}) == 12
    assert parcel_colour(12) == parcel_colour(0)


def test_same_run_gives_the_same_picture(tmp_path, plane, plane_record):
    for name in ("a.png", "b.png"):
        save_picture(tmp_path / name, plane, plane_record)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_row_is_told_from_plane(row, plane):
    assert is_row(row)
    assert not is_row(plane)


def test_wheels_have_a_panel_for_each_quantity(plane, plane_record):
    panels = draw_wheels(plane, plane_record).axes[::2]
    told = [axes.get_ylabel() for axes in panels]
    assert told == ["contact", "normal [N]", "friction [N]", "slip [m/s]"]
    contact, normal = (axes.collections[0].get_array() for axes in panels[:2])
    # The first axes of all cells, then the second ones.
    by_axis = [*range(0, 36, 2), *range(1, 36, 2)]
    np.testing.assert_array_equal(contact, plane_record.contact[:-1, by_axis].T)
    np.testing.assert_array_equal(normal, plane_record.normal_n[:-1, by_axis].T)
    named = [text.get_text() for text in panels[0].texts]
    assert named == ["axis 1", "axis 2"]


def test_one_wheel_far_out_does_not_set_the_scale_of_all(plane, plane_record):
    plane_record.force_n[7, 5] = 500.0
    friction = draw_wheels(plane, plane_record).axes[4].collections[0]
    assert friction.norm.vmax < 20.0
    assert friction.norm.vmin == -friction.norm.vmax


def test_creep_of_wheels_that_roll_is_no_slip(plane, plane_record):
    record = replace(plane_record, pose=plane_record.pose * 0, twist=plane_record.pose * 0)
    record.speed_m_s[:] = 1e-8
    slip = draw_wheels(plane, record).axes[6].collections[0]
    assert slip.norm.vmax == pytest.approx(5e-3)


def test_long_run_is_thinned_for_the_wheels(row, row_record):
    many = 5000
    long = Record(
        np.linspace(0, 50, many),
        np.zeros((many, 1, 3)),
        np.zeros((many, 1, 3)),
        *[np.zeros((many, 10))] * 5,
        np.zeros((many, 10), dtype=np.int8),
    )
    stripes = draw_wheels(row, long).axes[0].collections[0]
    assert stripes.get_array().shape[1] <= 1500


@pytest.fixture(params=["5 $ and 6 $", r"$\frac{", "_hidden", "数", "<b>"])
def named(request):
    """Gives a scenario this text for its title and its parcel's name."""

    def rename(scenario):
        parcel = replace(scenario.parcel[0], name=request.param)
        return replace(scenario, title=request.param, parcel=(parcel,))

    return rename


def test_any_text_can_be_drawn_in_the_plane(tmp_path, plane, plane_record, named):
    save_picture(tmp_path / "picture.png", named(plane), plane_record)


def test_any_text_can_be_drawn_on_the_row(tmp_path, row, row_record, named):
    save_picture(tmp_path / "picture.png", named(row), row_record)
    save_wheels(tmp_path / "wheels.png", named(row), row_record)


@pytest.mark.filterwarnings("error")
def test_a_run_that_ends_as_it_begins_is_drawn(tmp_path, row):
    tips = replace(row, parcel=(replace(row.parcel[0], x_m=0.63),))
    record = solve_row(tips, np.zeros(10))
    assert record.time_s.tolist() == [0.0]
    save_picture(tmp_path / "picture.png", tips, record)
    save_wheels(tmp_path / "wheels.png", tips, record)


@pytest.mark.parametrize(
    "shape",
    [
        {"shape": "disc", "length_m": 0.3, "width_m": 0.3},
        {"shape": "polygon", "corners_m": ((-0.1, -0.1), (0.15, 0.0), (-0.1, 0.1))},
    ],
)
def test_parcel_of_any_shape_is_drawn_by_its_outline(tmp_path, plane, plane_record, shape):
    scenario = replace(plane, parcel=(replace(plane.parcel[0], **shape),))
    view = draw_plane(scenario, plane_record).axes[0]
    wanted = outline_m(plane_record.pose[-1, 0], scenario.parcel[0])
    drawn = [patch.get_xy()[:-1] for patch in view.patches if hasattr(patch, "get_closed")]
    assert any(same_corners(corners, wanted) for corners in drawn)


def test_disc_is_round():
    disc = Parcel("disc", 1.0, 0.3, 0.3, shape="disc")
    corners_m = outline_m(np.array([1.0, 2.0, 0.5]), disc)
    np.testing.assert_allclose(np.hypot(*(corners_m - (1.0, 2.0)).T), 0.15)


def test_outline_turns_with_the_parcel():
    parcel = Parcel("plate", 1.0, 0.4, 0.2)
    corners_m = outline_m(np.array([0.0, 0.0, np.pi / 2]), parcel)
    np.testing.assert_allclose(np.ptp(corners_m, axis=0), [0.2, 0.4])


def test_belief_is_drawn_where_there_is_no_truth_and_said_to_be_one(plane, believed_record):
    scenario, record = drawable(plane, believed_record)
    np.testing.assert_array_equal(record.pose[5:], believed_record.estimate[5:])
    # Before it is found, the parcel lies where it is found.
    np.testing.assert_array_equal(record.pose[:5], believed_record.estimate[[5] * 5])
    figure = draw_plane(scenario, record)
    assert "as the coordinator believes" in text_of(figure)
    assert "wheel rolled" not in [text.get_text() for axes in figure.axes for text in axes.texts]


def test_believed_parcels_that_come_and_go_are_away_in_between(plane, believed_record):
    believed_record.estimate[20:30] = np.nan
    coming = replace(plane, stream=(Stream(("box",), 0.0, 0.0),))
    _, record = drawable(coming, believed_record)
    away = np.isnan(record.pose[:, 0, 0])
    assert np.flatnonzero(away).tolist() == [*range(5), *range(20, 30)]
    draw_plane(*drawable(coming, believed_record))


def test_truth_is_drawn_as_it_is(plane, plane_record):
    assert drawable(plane, plane_record) == (plane, plane_record)


def test_parcel_that_was_never_found_is_not_drawn(tmp_path, plane, believed_record):
    lost = replace(believed_record, estimate=np.full_like(believed_record.estimate, np.nan))
    scenario, record = drawable(plane, lost)
    assert scenario.parcel == ()
    assert record.pose.shape == (len(record.time_s), 0, 3)
    save_picture(tmp_path / "lost.png", plane, lost)
    assert (tmp_path / "lost.png").read_bytes().startswith(b"\x89PNG")


def test_row_of_belief_has_no_bands(row, row_record):
    belief = replace(
        row_record,
        pose=np.full_like(row_record.pose, np.nan),
        estimate=row_record.pose,
        contact=np.full_like(row_record.contact, Contact.UNKNOWN),
    )
    axes = draw_row(*drawable(row, belief)).axes[0]
    assert not bands_of_cell(axes, -4.5 * row.array.pitch_m)
    assert len(axes.lines) == 3


def test_wheels_of_belief_are_references_and_speeds(plane, believed_record):
    axes = draw_wheels(plane, believed_record).axes[::2]
    labels = [each.get_ylabel() for each in axes]
    assert labels == ["reference [m/s]", "speed [m/s]"]


def test_a_parcel_that_comes_and_goes_is_drawn_where_it_was(plane, plane_record):
    record = replace(plane_record, pose=plane_record.pose.copy())
    record.pose[:5] = record.pose[20:30] = record.pose[-1] = np.nan
    figure = draw_plane(plane, record)
    (path,) = [line for line in figure.axes[0].lines if len(line.get_xdata()) == len(record.pose)]
    assert np.isnan(path.get_xdata()).sum() == 16
    assert "nan" not in " ".join(text.get_text() for text in figure.texts)


def test_a_turn_that_rounds_to_none_has_no_minus(plane, plane_record):
    record = replace(plane_record, pose=plane_record.pose.copy())
    record.pose[:, :, 2] = np.linspace(0.0, -1e-4, len(record.pose))[:, np.newaxis]
    assert "turned +0.0°" in text_of(draw_plane(plane, record))


def test_one_that_was_never_there_is_left_out(plane, plane_record):
    record = replace(plane_record, pose=np.full_like(plane_record.pose, np.nan))
    draw_plane(plane, record)
