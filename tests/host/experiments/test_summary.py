"""Summaries: shares with Wilson's interval, medians with a seeded bootstrap, and their pictures."""

import numpy as np
import pytest

import mdms_array as mdms
from mdms_array.experiments.settings import settings_of
from mdms_array.experiments.summary import (
    bootstrap,
    cells_of,
    mean_interval,
    summarised,
    wilson,
)


def table(over, measures=None, samples=32):
    """A sweep in which slower and stickier settings arrive."""
    rows = []
    for setting in settings_of(over, samples, "latin_hypercube", 1):
        for replication in range(4):
            friction = setting.get("cell.friction", 0.3)
            speed_m_s = setting.get("motion.speed_m_s", 0.3)
            reached = bool(friction * (3 + replication) > 4 * speed_m_s)
            values = {"reached": reached, "time_s": 2.0 / speed_m_s + replication}
            rows.append({**setting, "failure": None} | (measures or values))
    names = ("reached", "time_s") if measures is None else tuple(measures)
    sampled = tuple(key for key in over if isinstance(over[key], mdms.Distribution))
    return mdms.SweepResult(rows, tuple(over), names, sampled)


def test_wilson_agrees_with_its_published_values():
    # Newcombe 1998, table 1: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for successes, trials, low, high in (
        *((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605)),
        *((0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)),
    ):
        assert wilson(successes, trials) == pytest.approx((low, high), abs=1e-4)
    assert wilson(20, 20)[1] == 1.0
    assert wilson(0, 0) == (0.0, 1.0)


def test_the_bootstrap_is_seeded_and_covers_the_median_as_often_as_it_says():
    rng = np.random.default_rng(5)
    samples = rng.normal(size=(300, 25))
    ends = [bootstrap(sample, (0.5,))[1:, 0] for sample in samples]
    covered = np.mean([low <= 0.0 <= high for low, high in ends])
    assert 0.91 < covered < 0.98
    sample = rng.normal(size=30)
    assert (bootstrap(sample, (0.1, 0.5)) == bootstrap(sample, (0.1, 0.5))).all()


@pytest.mark.parametrize(("quantile", "least"), [(0.5, 6), (0.1, 29), (0.9, 29)])
def test_no_interval_is_given_where_all_values_may_lie_on_one_side(quantile, least):
    values = np.arange(least, dtype=float)
    assert np.isfinite(bootstrap(values, (quantile,))).all()
    middle, low, high = bootstrap(values[:-1], (quantile,))[:, 0]
    assert np.isfinite(middle)
    assert np.isnan((low, high)).all()


@pytest.mark.parametrize("count", [2, 3, 12])
def test_the_interval_of_a_mean_is_seldom_above_it(count):
    rng = np.random.default_rng(count)
    above = np.mean([mean_interval(values)[1] > 0.0 for values in rng.normal(size=(2000, count))])
    assert 0.015 < above < 0.035
    mean, low, high = mean_interval([1.0, 2.0, 3.0, 4.0])
    assert (mean, low, high) == pytest.approx((2.5, 2.5 - 2.054, 2.5 + 2.054), abs=1e-3)


def test_a_summary_has_a_row_for_each_setting_or_each_value():
    result = table({"cell.friction": [0.2, 0.4], "motion.speed_m_s": [0.1, 0.2, 0.3]})
    assert len(result.summary()) == 6
    by_friction = result.summary(["cell.friction"])
    assert [*by_friction["cell.friction"]] == [0.2, 0.4]
    assert [*by_friction["runs"]] == [12, 12]
    slow, fast = by_friction["reached_share"]
    assert slow < fast
    assert (by_friction["reached_low"] <= by_friction["reached_share"]).all()
    assert (by_friction["time_s_q10"] <= by_friction["time_s_median"]).all()


def test_a_parameter_that_was_sampled_is_put_into_classes():
    result = table({"cell.friction": mdms.uniform(0.1, 0.5)})
    by_friction = result.summary(["cell.friction"])
    assert len(by_friction) == 6
    assert by_friction["runs"].sum() == 128


def test_runs_that_raised_are_counted_and_in_no_share():
    result = table({"cell.friction": [0.4]})
    failed = {"cell.friction": 0.4, "failure": "ValueError: no", "reached": None, "time_s": None}
    summary = mdms.SweepResult([*result.rows, failed], result.parameters, result.measures).summary()
    assert summary["failed"][0] == 1
    assert summary["reached_share"][0] == result.summary()["reached_share"][0]


def test_runs_without_a_value_are_told():
    result = table({"cell.friction": [0.4]})
    away = {"cell.friction": 0.4, "failure": None, "reached": False, "time_s": None}
    result = mdms.SweepResult([*result.rows, away], result.parameters, result.measures)
    (row,) = summarised(result)
    assert (row["runs"], row["reached_runs"], row["time_s_runs"]) == (5, 5, 4)
    _, _, _, share, median = cells_of(row, result.parameters, result.measures)
    assert "runs" not in share
    assert median == f"{row['time_s_median']:.3g}, 4 of 5 runs"  # too few for an interval
    result = mdms.SweepResult([*result.rows * 2, away], result.parameters, result.measures)
    (row,) = summarised(result)
    assert cells_of(row, result.parameters, result.measures)[-1].endswith("], 8 of 11 runs")
    silent = table({"cell.friction": [0.4]}, {"miss_m": None})
    (row,) = summarised(silent)
    assert cells_of(row, silent.parameters, silent.measures)[-1] == "0 of 4 runs"


GRID = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]


@pytest.mark.parametrize(
    ("over", "shape"),
    [
        ({"cell.friction": GRID}, 1),
        ({"motion.control": ["host", "cells"]}, 1),
        ({"cell.friction": GRID, "motion.control": ["host", "cells"]}, 1),
        ({"cell.friction": GRID, "fault": [[], [{"kind": "loss"}]]}, 1),
        ({"cell.friction": GRID, "motion.speed_m_s": GRID}, 2),
        ({"cell.friction": mdms.uniform(0.1, 0.5), "motion.speed_m_s": mdms.uniform(0.1, 0.5)}, 2),
        ({"cell.friction": GRID, "motion.speed_m_s": GRID, "motion.control": ["host", "x"]}, 6),
    ],
)
def test_each_kind_of_sweep_has_a_picture(over, shape, tmp_path):
    figure = table(over).plot(tmp_path / "picture.png")
    assert len(figure.axes) == shape
    first = (tmp_path / "picture.png").read_bytes()
    table(over).plot(tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == first


@pytest.mark.parametrize("measure", ["time_s", "reached"])
def test_texts_of_a_picture_keep_apart_and_inside(measure, tmp_path):
    key = "truth.parcel.box.centre_of_mass_m.0"
    result = table({"motion.speed_m_s": GRID, key: [0.1, 0.2]})
    figure = result.plot(tmp_path / "picture.png", measure)
    title, note = (text.get_window_extent() for text in figure.texts)
    (axes,), (legend,) = figure.axes, figure.legends
    assert title.y0 > note.y1
    assert note.y0 > axes.get_window_extent().y1
    for box in (title, note, legend.get_window_extent()):
        assert box.x1 < figure.bbox.x1


def test_a_picture_names_the_bands_that_it_has(tmp_path):
    lines, marks = {"cell.friction": [0.1, 0.2]}, {"motion.control": ["host", "cells"]}
    for over, repeats, measures, told in (
        (lines, 1, None, "8 runs; light: 80 % of runs"),
        (lines, 2, None, "16 runs; dark: 95 % interval of the median, light: 80 % of runs"),
        (lines, 1, {"time_s": 1.0}, "8 runs"),
        (marks, 1, None, "8 runs"),
        (marks, 2, None, "16 runs; band: 95 % interval"),
    ):
        drawn = table(over, measures)
        result = mdms.SweepResult(drawn.rows * repeats, drawn.parameters, drawn.measures)
        figure = result.plot(tmp_path / "picture.png", "time_s")
        assert figure.texts[1].get_text() == told


def test_a_picture_of_a_missing_column_is_refused(tmp_path):
    result = table({"cell.friction": GRID})
    with pytest.raises(mdms.InputError, match=r"speed has no numbers to draw; there are reached"):
        result.plot(tmp_path / "a.png", "speed")
    with pytest.raises(mdms.InputError, match=r"motion.speed_m_s does not vary; there are cell"):
        result.plot(tmp_path / "a.png", over=["motion.speed_m_s"])
    with pytest.raises(mdms.InputError, match="no parameter to draw over"):
        result.plot(tmp_path / "a.png", over=[])
    with pytest.raises(mdms.InputError, match="no measure has a number"):
        table({"cell.friction": GRID}, {"text": "far"}).plot(tmp_path / "a.png")
    with pytest.raises(mdms.InputError, match=r"the name is to end in \.png, \.svg or \.pdf"):
        result.plot(tmp_path / "a.xyz")


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0], "log"),
        ([0.1, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "linear"),
        ([1.0, 2.0, 3.0], "linear"),
    ],
)
def test_an_axis_is_logarithmic_where_that_spreads_its_values(values, scale, tmp_path):
    (axes,) = table({"cell.friction": values}).plot(tmp_path / "a.png").axes
    assert axes.get_xscale() == scale


def test_a_single_value_has_a_bar_and_tables_have_short_labels(tmp_path):
    (axes,) = table({"cell.friction": [0.3]}).plot(tmp_path / "a.png").axes
    assert len(axes.containers) == 1
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0.3"]
    faults = [[], [{"kind": "loss", "probability": 0.1}], [{"kind": "off", "cells": [*range(40)]}]]
    (axes,) = table({"fault": faults}).plot(tmp_path / "a.png").axes
    labels = [label.get_text() for label in axes.get_xticklabels()]
    assert labels == ["none", "loss 0.1", "off [0, 1, 2, 3, \u2026"]


def test_more_lines_than_colours_look_different(tmp_path):
    texts = [f"field {k}" for k in range(9)]
    axes = table({"cell.friction": GRID, "motion.field": texts}).plot(tmp_path / "a.png").axes[0]
    looks = {(line.get_color(), line.get_marker()) for line in axes.lines}
    assert len(looks) == len(texts)
