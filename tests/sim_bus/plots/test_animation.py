"""A run that cells steered, as a GIF, and in the picture."""

from dataclasses import fields, replace

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb
from PIL import Image

from mdms_model.run.colours import parcel_colour
from mdms_model.run.record import Record
from mdms_protocol.neighbours import frames as wire
from mdms_sim.plots import animation, drawable, save_animation, save_picture
from mdms_sim.plots.canvas import MARK, PictureFormatError, new_figure
from mdms_sim.plots.held_cells import FREE, HeldCells
from mdms_sim.plots.moving_view import MovingView
from mdms_sim.plots.plane import draw_plane


def until(record, samples):
    """The first samples of a record; one is 0.1 s."""
    history = [name.name for name in fields(Record) if name.name != "events"]
    values = {name: getattr(record, name) for name in history}
    cut = {name: value[:samples] for name, value in values.items() if value is not None}
    return replace(record, **cut)


@pytest.fixture
def short(held_record):
    return until(held_record, 8)


def frames(path):
    with Image.open(path) as picture:
        assert picture.format == "GIF"
        return picture.n_frames


def test_animation_has_ten_frames_a_second_and_says_who_drew_it(tmp_path, plane, short):
    path = tmp_path / "run.gif"
    save_animation(path, plane, short)
    assert frames(path) == 8
    assert path.stat().st_size < animation.MOST_BYTES
    assert MARK.encode() in path.read_bytes()
    with Image.open(path) as picture:
        assert picture.width == 640


def test_picture_named_gif_is_the_animation_and_the_same_each_time(tmp_path, plane, short):
    brief = until(short, 3)
    save_picture(tmp_path / "a.gif", plane, brief)
    save_animation(tmp_path / "b.GIF", plane, brief)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.GIF").read_bytes()


def test_run_in_which_no_cell_reported_has_no_animation(tmp_path, plane, plane_record):
    with pytest.raises(PictureFormatError, match=r"motion\.control = 'cells'"):
        save_picture(tmp_path / "run.gif", plane, plane_record)
    assert not list(tmp_path.iterdir())


def test_animation_that_is_too_large_has_fewer_frames_that_stay_longer(
    tmp_path, monkeypatch, plane, short
):
    path = tmp_path / "run.gif"
    save_animation(path, plane, short)
    monkeypatch.setattr(animation, "MOST_BYTES", path.stat().st_size - 1)
    save_animation(path, plane, short)
    assert path.stat().st_size <= animation.MOST_BYTES
    assert frames(path) == 4
    with Image.open(path) as picture:
        assert picture.info["duration"] == 2 * animation.FRAME_MS


def test_long_run_is_shown_faster(tmp_path, monkeypatch, plane, short):
    monkeypatch.setattr(animation, "MOST_FRAMES", 3)
    drawn = []

    class View(MovingView):
        def __init__(self, scenario, record, times):
            super().__init__(scenario, record, times)
            drawn.append(times)

        def pixels(self, instant):
            drawn.append(instant)
            return super().pixels(instant)

    monkeypatch.setattr(animation, "MovingView", View)
    save_animation(tmp_path / "run.gif", plane, short)
    assert drawn == [pytest.approx(3.5), 0, 4, 7]


def test_parcel_in_motion_changes_the_frame(plane, held_record):
    view = MovingView(plane, held_record)
    first, again, later = (view.pixels(instant) for instant in (10, 10, 20))
    assert first.shape[1:] == (640, 3)
    np.testing.assert_array_equal(first, again)
    assert (first != later).any()


def test_squares_are_filled_under_a_parcel_outlined_where_promised_and_pale_nearby(plane):
    axes = new_figure(2, 2).add_axes((0, 0, 1, 1))
    cells = HeldCells(axes, plane.array)
    identity, state = (np.zeros(18, np.int8) for _ in range(2))
    identity[:3] = 2
    state[:4] = wire.UNDER, wire.PROMISED, wire.NEAR, wire.NONE
    cells.show(identity, state)
    faces, edges = cells.squares.get_facecolor(), cells.squares.get_edgecolor()
    under, promised, near, free = (sum(face[:3]) for face in faces[:4])
    assert under < near < promised
    assert promised == 3.0
    assert to_hex(edges[1]) == parcel_colour(1)
    assert to_hex(faces[3]) == FREE
    assert free == pytest.approx(sum(to_rgb(FREE)), abs=1e-6)


def test_picture_shows_how_far_the_cells_belief_was_off(plane, held_record):
    panels = draw_plane(plane, held_record).axes
    away, turn = (axes for axes in panels if axes.get_ylabel().startswith("belief off by"))
    # The first line is what the host believes.
    np.testing.assert_allclose(away.lines[1].get_ydata()[5:], 2.0)
    np.testing.assert_allclose(turn.lines[1].get_ydata()[5:], np.degrees(0.01))


def test_run_on_hardware_is_animated_as_the_coordinator_believes(tmp_path, plane, short):
    nowhere = np.full_like(short.pose, np.nan)
    save_animation(tmp_path / "run.gif", plane, replace(short, pose=nowhere))
    assert frames(tmp_path / "run.gif") > 1


def test_parcels_keep_their_cells_where_one_before_was_never_found(plane, believed_record):
    box = plane.parcel[0]
    scenario = replace(plane, parcel=(replace(box, name="lost"), box))
    estimate = np.concatenate(
        (np.full_like(believed_record.estimate, np.nan), believed_record.estimate), axis=1
    )
    identity = np.tile(np.array([0, 1, 2, 3], np.int8), (len(estimate), 1))
    record = replace(
        believed_record, pose=np.full_like(estimate, np.nan), estimate=estimate, identity=identity
    )
    shown, drawn = drawable(scenario, record)
    assert [parcel.name for parcel in shown.parcel] == [box.name]
    assert drawn.identity[0].tolist() == [0, 2, 1, 3]
