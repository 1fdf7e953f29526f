"""The examples of sweeps, in small: they agree with the paper, and draw their pictures."""

import runpy
from pathlib import Path

import pytest

import mdms_array as mdms
from mdms_array.experiments.files import read_tuning
from mdms_array.experiments.sweep import design_of

EXAMPLES = Path(__file__).parents[3] / "examples"


def names_of(example, **changed):
    """The names of an example, with smaller lists in their place."""
    names = runpy.run_path(str(EXAMPLES / example))
    names["swept"].__globals__.update(changed)
    return names


def test_the_box_of_figure_8_swings_as_the_closed_form_says(executor, tmp_path):
    names = names_of("swing.py", FRICTIONS=[0.1, 0.4], MASSES_KG=[1.0, 4.0])
    result = names["swept"](executor=executor)
    for row in result.rows:
        closed_hz = names["closed_form_hz"](row["cell.friction"])
        if row["parcel.box.x_m"] == -0.02:
            assert row["frequency_hz"] == pytest.approx(closed_hz, rel=1e-6)
        else:
            assert row["frequency_hz"] < 0.8 * closed_hz
    names["draw"](result, str(tmp_path / "swing.png"))


def test_no_wheel_slides_below_the_bound_and_most_do_above(executor, tmp_path):
    speeds_m_s = [0.02, 0.05, 0.4, 1.0]
    names = names_of("rolling_ends.py", GAINS_VS_PER_M=[5.0, 20.0], SPEEDS_M_S=speeds_m_s)
    result = names["swept"](executor=executor)
    for row in result.rows:
        bounds = names["bounds_m_s"](row["cell.gain_vs_per_m"])
        if row["motion.speed_m_s"] < bounds["rolling_max_m_s"]:
            assert row["sliding_share"] == 0.0
        if row["motion.speed_m_s"] > 1.5 * bounds["sliding_min_m_s"]:
            assert row["sliding_share"] > 0.7
    names["draw"](result, str(tmp_path / "ends.png"))


def test_the_sweep_of_losses_and_the_tuning_are_well_formed(tmp_path):
    names = runpy.run_path(str(EXAMPLES / "losses.py"))
    designs = []
    for swept in (names["lost_frames"], names["dead_cells"]):
        swept.__globals__["mdms"] = Recorder(designs)
        swept(seeds=2)
    losses, dead = designs
    assert len(losses.settings) == 10
    assert len(dead.settings) == 8
    assert read_tuning(EXAMPLES / "tune18.toml").objective == "time_s"


class Recorder:
    """Stands for `mdms_array`: notes designs, and runs none."""

    SweepResult = mdms.SweepResult

    def __init__(self, designs):
        self._designs = designs

    def sweep(self, scenario, over, *, folder=None, **more):
        self._designs.append(design_of(scenario, over, **more))
