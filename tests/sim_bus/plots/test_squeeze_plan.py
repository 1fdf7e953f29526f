"""The picture of a plan of squeezes."""

import numpy as np
import pytest

from mdms_model.scenario.scenario import Array, Cell, Parcel, Scenario, Wheel
from mdms_model.squeeze import plan_squeezes, squeeze_function
from mdms_sim.physics.squeeze_trials import Trials
from mdms_sim.plots.canvas import save
from mdms_sim.plots.squeeze_plan import draw_squeeze_plan

CORNERS = ((-0.2, -0.17), (0.2, -0.17), (0.02, 0.19))
PART = Parcel("part", 1.0, 0.4, 0.38, shape="polygon", corners_m=CORNERS)
TABLE = Scenario("A table", Array(6, 4), Cell(wheel=(Wheel(0.0),)), (PART,))
PLAN = plan_squeezes(squeeze_function(np.array(CORNERS)))


@pytest.fixture
def trials():
    random = np.random.default_rng(1)
    pose = random.uniform(-0.1, 0.1, (5, len(PLAN.steps) + 1, 3))
    pose[0, 2:] = np.nan
    return Trials(pose, np.ones((5, len(PLAN.steps)), dtype=bool))


def titles(figure):
    return [axes.get_title() or axes.get_title(loc="left") for axes in figure.axes]


def test_a_plan_alone_shows_the_squeeze_function_its_steps_and_their_results():
    figure = draw_squeeze_plan(TABLE, PART, PLAN, None)
    assert titles(figure)[0] == "Squeeze function"
    assert titles(figure)[2:] == [
        "1. line along 0.0°",
        "2. line along 145.6°",
        "3. line along 178.0°",
    ]
    planned = figure.axes[2:]
    assert [len(axes.patches) for axes in planned] == [3, 2, 1]


def test_every_planned_outline_lies_as_much_on_one_side_of_the_line_as_on_the_other():
    figure = draw_squeeze_plan(TABLE, PART, PLAN, None)
    for outline in figure.axes[2].patches:
        corners = outline.get_xy()[:-1]
        assert corners[:, 1].min() < 0.0 < corners[:, 1].max()


def test_trials_stand_below_the_plan_with_those_that_tipped_counted(trials):
    figure = draw_squeeze_plan(TABLE, PART, PLAN, trials)
    said = titles(figure)
    assert "Trials" in said
    assert any(text.endswith("1 have tipped") for text in said)
    assert len(figure.axes) == 3 + 2 * len(PLAN.steps)


def test_the_same_plan_gives_the_same_bytes(trials, tmp_path):
    for name in ("one.png", "two.png"):
        save(draw_squeeze_plan(TABLE, PART, PLAN, trials), tmp_path / name)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
