"""The animation of a run that cells steered: in its run folder, and drawn again from it."""

import pytest

from mdms_host.cli import main


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """A frame for each tenth of a second, however short the run is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mdms_sim.plots.animation.LEAST_FRAMES", 2)
        yield


@pytest.fixture(scope="module")
def run(coarse, tmp_path_factory):
    """Cells report the box from half a second on."""
    folder = tmp_path_factory.mktemp("steered") / "run"
    main(["simulate", "neighbours", "--set", "run.duration_s=0.6", "--out", str(folder)])
    return folder


def test_run_that_cells_steer_leaves_an_animation_that_plot_draws_again(run, tmp_path, capsys):
    assert (run / "animation.gif").read_bytes().startswith(b"GIF89a")
    again = tmp_path / "again.gif"
    assert main(["plot", str(run), "--out", str(again)]) == 0
    assert capsys.readouterr().out == f"{again}\n"
    assert again.read_bytes() == (run / "animation.gif").read_bytes()


def test_run_of_one_parcel_leaves_none_but_is_animated_when_asked_to(tmp_path, capsys):
    folder = tmp_path / "run"
    assert (
        main(["simulate", "paper-fig7", "--set", "run.duration_s=0.1", "--out", str(folder)]) == 0
    )
    assert not (folder / "animation.gif").exists()
    assert main(["plot", str(folder), "--out", str(tmp_path / "x.gif")]) == 0
    assert (tmp_path / "x.gif").read_bytes().startswith(b"GIF89a")
