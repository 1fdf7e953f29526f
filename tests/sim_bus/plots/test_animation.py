"""A run as an animation; what cells reported, in it and in the picture."""

import shutil
import sys
from dataclasses import fields, replace
from importlib.util import find_spec

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb
from PIL import Image

from mdms_model.run.colours import parcel_colour
from mdms_model.run.record import Plan, Record, Tile
from mdms_protocol.neighbours import frames as wire
from mdms_sim.plots import animation, check_name, drawable, save_picture
from mdms_sim.plots.animation import EncoderMissingError
from mdms_sim.plots.canvas import MARK, new_figure
from mdms_sim.plots.moving_view import MovingView
from mdms_sim.plots.plane import draw_plane
from mdms_sim.plots.top_view import FREE, HeldCells


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


def test_animation_has_ten_frames_a_second_and_names_its_maker(tmp_path, plane, short):
    path = tmp_path / "run.gif"
    save_picture(path, plane, short)
    assert frames(path) == 8
    assert path.stat().st_size < animation.MOST_BYTES
    assert MARK.encode() in path.read_bytes()
    with Image.open(path) as picture:
        assert picture.width == 640


def test_picture_named_gif_is_the_animation_and_the_same_each_time(tmp_path, plane, short):
    brief = until(short, 3)
    save_picture(tmp_path / "a.gif", plane, brief)
    save_picture(tmp_path / "b.GIF", plane, brief)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.GIF").read_bytes()


def test_run_that_the_host_steered_shows_ways_goals_and_tiles_as_they_are_planned(
    plane, plane_record
):
    way = np.array([[0.0, 0.1, 0.0], [0.3, 0.1, 0.0]])
    tiles = (Tile(0.1, -0.1, 0.03, ("box",)), Tile(0.2, -0.1, 0.03, ("box",)))
    plans = [
        Plan(1.0, {"box": way}, tiles, goals={"box": np.array([0.3, 0.1, np.nan])}),
        Plan(2.0, {}),
    ]
    view = MovingView(plane, replace(plane_record, plans=plans))
    shown = []
    for instant in (5, 15, 25):
        view.pixels(instant)
        (parcel,) = view.parcels
        shown.append(
            (
                len(parcel.way.get_xdata()) > 1,
                parcel.goal.get_visible(),
                len(view.tiles.get_paths()),
            )
        )
    assert shown == [(False, False, 0), (True, True, 2), (False, False, 0)]
    assert parcel.way.get_color() == parcel_colour(0)


def test_parcel_that_is_away_is_not_drawn_and_one_that_is_there_is_named(plane, plane_record):
    pose = np.tile(plane_record.pose, (1, 2, 1))
    pose[:10, 1] = np.nan
    box = plane.parcel[0]
    pair = replace(plane, parcel=(box, replace(box, name="second")))
    record = replace(plane_record, pose=pose, twist=pose, estimate=np.full_like(pose, np.nan))
    view = MovingView(pair, record)
    for instant, there in ((5, [True, False]), (15, [True, True])):
        view.pixels(instant)
        assert [parcel.name.get_visible() for parcel in view.parcels] == there
    assert [parcel.name.get_text() for parcel in view.parcels] == ["box", "second"]


def test_video_is_written_where_there_is_an_encoder_and_refused_by_name_where_there_is_none(
    tmp_path, plane, short
):
    path = tmp_path / "run.mp4"
    if shutil.which("ffmpeg") or find_spec("imageio_ffmpeg"):
        save_picture(path, plane, until(short, 3))
        assert path.read_bytes()[4:8] == b"ftyp"
        assert MARK.encode() in path.read_bytes()
    else:
        with pytest.raises(EncoderMissingError, match="pip install imageio-ffmpeg"):
            check_name(path)


def test_frames_go_to_the_encoder_in_its_own_terms_and_its_messages_are_passed_on(
    tmp_path, monkeypatch, plane, short
):
    encoder = tmp_path / "ffmpeg"
    encoder.write_text(f"#!{sys.executable}\n" + ENCODER)
    encoder.chmod(0o755)
    monkeypatch.setattr(animation, "find_encoder", lambda: str(encoder))
    save_picture(tmp_path / "run.mp4", plane, until(short, 3))
    taken = (tmp_path / "run.mp4").read_text()
    # Six frames in 0.2 s, both ends among them, and two seconds of the last.
    assert taken == "56 frames drawn by mdms"
    with pytest.raises(EncoderMissingError, match=r"wrote no MP4: No such file"):
        save_picture(tmp_path / "none" / "run.mp4", plane, until(short, 3))


#: Takes raw frames as ffmpeg does, of the size and colours that it is called with.
ENCODER = """
import sys
given = dict(zip(sys.argv[1:], sys.argv[2:]))
assert (given["-f"], given["-c:v"], given["-i"]) == ("mp4", "libx264", "-"), given
assert given["-pix_fmt"] == "yuv420p", given
width, height = map(int, given["-s"].split("x"))
assert width % 2 == height % 2 == 0
data = sys.stdin.buffer.read()
assert len(data) % (3 * width * height) == 0
try:
    with open(sys.argv[-1], "w") as file:
        comment = given["-metadata"].removeprefix("comment=")
        file.write(f"{len(data) // (3 * width * height)} frames {comment}")
except OSError as error:
    sys.exit(error.strerror)
"""


def test_animation_that_is_too_large_has_fewer_frames_that_stay_longer(
    tmp_path, monkeypatch, plane, short
):
    path = tmp_path / "run.gif"
    save_picture(path, plane, short)
    monkeypatch.setattr(animation, "MOST_BYTES", path.stat().st_size - 1)
    save_picture(path, plane, short)
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
    save_picture(tmp_path / "run.gif", plane, short)
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
    # The first line is the host's belief.
    np.testing.assert_allclose(away.lines[1].get_ydata()[5:], 2.0)
    np.testing.assert_allclose(turn.lines[1].get_ydata()[5:], np.degrees(0.01))


def test_run_on_hardware_is_animated_as_the_coordinator_believes(tmp_path, plane, short):
    nowhere = np.full_like(short.pose, np.nan)
    save_picture(tmp_path / "run.gif", plane, replace(short, pose=nowhere))
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
