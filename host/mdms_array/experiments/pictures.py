"""Pictures of a sweep: lines with bands, a map, or a matrix of all measures over all parameters."""

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.figure import Figure
from matplotlib.ticker import (
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    PercentFormatter,
)

from mdms_array.experiments.summary import is_numeric, is_share, summarised
from mdms_model.arrays import Floats
from mdms_model.errors import InputError
from mdms_sim.plots.canvas import FAINT, INK, new_figure, tidy

if TYPE_CHECKING:
    from mdms_array.experiments.sweep import SweepResult
    from mdms_array.experiments.tuning import Tuned

#: Colours that colour-blind people tell apart (Okabe and Ito), of lines by their second parameter.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
#: Lines of more values have other markers.
MARKERS = ("o", "s", "^", "D", "v", "P")
MAP = "viridis"
#: A second parameter with so many values at most makes lines, and with more a map.
MOST_LINES = len(COLOURS)
#: A map with so many cells at most has the numbers in it.
MOST_NUMBERS = 80
#: Values further apart than by this factor, and all above 0, are drawn on a logarithmic axis.
_WIDE = 10.0
#: Longer texts of values are cut.
_LONGEST = 18
#: A line of a legend's title has so many characters at most, unless one part of a name has more.
_LEGEND = 24
Row = dict[str, Any]


def draw(
    result: "SweepResult", measure: str | None = None, over: Sequence[str] | None = None
) -> Figure:
    """A measure over one or two parameters, or all measures over all. Raises `InputError`.

    A second parameter with up to six values, or with texts, makes a line for each value.
    """
    parameters = result.parameters if over is None else tuple(over)
    for name in parameters:
        if name not in result.parameters:
            raise InputError(f"{name} does not vary; there are {', '.join(result.parameters)}")
    if not parameters:
        raise InputError("there is no picture: no parameter to draw over")
    drawable = [name for name in result.measures if _kind(result, name)]
    if not drawable:
        raise InputError("there is no picture: no measure has a number in any run")
    chosen = drawable[0] if measure is None else measure
    if chosen not in drawable:
        raise InputError(f"{chosen} has no numbers to draw; there are {', '.join(drawable)}")
    if len(parameters) == 1:
        return draw_lines(result, chosen, parameters[0])
    if len(parameters) == 2:
        first, second = parameters
        fewer, more = sorted(parameters, key=lambda name: len(_values(result, name)))
        few = len(_values(result, fewer)) <= MOST_LINES
        if few or not is_numeric(_values(result, first) + _values(result, second)):
            if not is_numeric(_values(result, more)) and is_numeric(_values(result, fewer)):
                fewer, more = more, fewer
            return draw_lines(result, chosen, more, fewer)
        return draw_map(result, chosen, first, second)
    return draw_matrix(result, drawable if measure is None else [chosen], parameters)


def draw_lines(result: "SweepResult", measure: str, over: str, by: str | None = None) -> Figure:
    """A measure over one parameter, with a line for each value of another.

    The dark band is the 95 % interval, the light one holds 80 % of all runs.
    """
    figure = new_figure(7.2, 4.4)
    axes = figure.add_axes((0.12, 0.15, 0.84 if by is None else 0.62, 0.72))
    rows = summarised(result, [over] if by is None else [over, by])
    groups = [None] if by is None else list({repr(row[by]): row[by] for row in rows}.values())
    for number, group in enumerate(groups):
        of_group = [row for row in rows if by is None or row[by] == group]
        again, place = divmod(number, len(COLOURS))
        looks = {"colour": COLOURS[place], "marker": MARKERS[again % len(MARKERS)]}
        label, shift = _short(group), (number - (len(groups) - 1) / 2) / len(groups)
        _draw_line(axes, of_group, measure, over, label=label, shift=shift, **looks)
    _label_x(axes, result, over)
    _label_y(axes, result, measure)
    if by is not None:
        legend = figure.legend(
            title=_broken(label_of(result, by), _LEGEND),
            loc="upper left",
            bbox_to_anchor=(0.75, 0.89),
            frameon=False,
            fontsize=8,
            title_fontsize=8,
            labelcolor=INK,
        )
        legend.set_alignment("left")
    bands = ["band: 95 % interval"]
    if _kind(result, measure) == "number":
        # Few runs have no interval, and runs that are alike no spread.
        known = any(row.get(f"{measure}_median_low") is not None for row in rows)
        spread = any(row.get(f"{measure}_q10") != row.get(f"{measure}_q90") for row in rows)
        has_both = _has_bands(_values(result, over))
        if has_both:
            bands = ["dark: 95 % interval of the median"]
        if not known:
            bands = []
        if has_both and spread:
            bands.append("light: 80 % of runs")
    _title(figure, result, f"{_of(result, measure)} over {over}", ", ".join(bands))
    return figure


def _draw_line(
    axes: Axes,
    rows: list[Row],
    measure: str,
    over: str,
    *,
    colour: str = COLOURS[0],
    marker: str = MARKERS[0],
    label: str = "",
    shift: float = 0.0,
) -> None:
    rows = [row for row in rows if _middle_key(row, measure)]
    if not rows:
        return
    key = _middle_key(rows[0], measure)
    low, high = (f"{measure}_low", f"{measure}_high")
    if key.endswith("_median"):
        low, high = f"{key}_low", f"{key}_high"
    if _has_bands([row[over] for row in rows]):
        rows = sorted(rows, key=lambda row: row[over])
        x = _column(rows, over)
        if f"{measure}_q10" in rows[0]:
            outer = _column(rows, f"{measure}_q10"), _column(rows, f"{measure}_q90")
            axes.fill_between(x, *outer, color=colour, alpha=0.12, linewidth=0)
        inner = _column(rows, low), _column(rows, high)
        axes.fill_between(x, *inner, color=colour, alpha=0.28, linewidth=0)
        axes.plot(x, _column(rows, key), f"{marker}-", color=colour, ms=4, lw=1.6, label=label)
        return
    middle = _column(rows, key)
    places = np.arange(len(rows)) + 0.5 * shift
    ends = np.abs(np.vstack((_column(rows, low), _column(rows, high))) - middle)
    axes.errorbar(places, middle, ends, fmt=marker, color=colour, ms=6, capsize=4, label=label)
    axes.set_xticks(np.arange(len(rows)), [_short(row[over]) for row in rows])
    axes.set_xlim(-0.5, len(rows) - 0.5)


def _has_bands(values: Sequence[Any]) -> bool:
    """Whether bands lead from value to value of a parameter; else each has a bar of its own."""
    return is_numeric(values) and len(values) > 1


def draw_map(result: "SweepResult", measure: str, x_name: str, y_name: str) -> Figure:
    """The median or the share of a measure over two parameters, as colours."""
    figure = new_figure(7.2, 5.0)
    axes = figure.add_axes((0.12, 0.13, 0.70, 0.75))
    bar_axes = figure.add_axes((0.85, 0.13, 0.025, 0.75))
    sampled = not _is_grid(result, x_name, y_name)
    every = None if {*result.parameters} == {x_name, y_name} else [x_name, y_name]
    rows = [row for row in summarised(result, every) if _middle_key(row, measure)]
    key = _middle_key(rows[0], measure)
    x, y, values = (_column(rows, name) for name in (x_name, y_name, key))
    limits: Any = {"vmin": 0.0, "vmax": 1.0} if key.endswith("_share") else {}
    if sampled:
        drawn: Any = axes.scatter(
            x, y, c=values, cmap=MAP, s=60, edgecolor="white", linewidth=0.6, **limits
        )
    else:
        columns, lines = np.unique(x), np.unique(y)
        table = np.full((len(lines), len(columns)), np.nan)
        table[np.searchsorted(lines, y), np.searchsorted(columns, x)] = values
        drawn = axes.pcolormesh(_edges(columns), _edges(lines), table, cmap=MAP, **limits)
        if table.size <= MOST_NUMBERS:
            _write_numbers(axes, columns, lines, table, key)
    bar = figure.colorbar(drawn, cax=bar_axes)
    bar.outline.set_visible(False)
    bar.ax.tick_params(colors=INK, labelsize=8)
    if key.endswith("_share"):
        bar.ax.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    _label_x(axes, result, x_name)
    axes.set_ylabel(label_of(result, y_name), color=INK)
    if _is_wide(y):
        _make_logarithmic(axes.yaxis)
    _title(figure, result, _of(result, measure))
    return figure


def _write_numbers(axes: Axes, columns: Floats, lines: Floats, table: Floats, key: str) -> None:
    known = table[np.isfinite(table)]
    low, high = (0.0, 1.0) if key.endswith("_share") else (known.min(), known.max())
    for (line, column), value in np.ndenumerate(table):
        if np.isfinite(value):
            text = f"{100 * value:.0f}" if key.endswith("_share") else f"{value:.3g}"
            light = (value - low) > 0.6 * (high - low)
            paint = INK if light else "white"
            place = float(columns[column]), float(lines[line])
            axes.text(*place, text, ha="center", va="center", fontsize=7, color=paint)


def draw_matrix(
    result: "SweepResult", measures: Sequence[str], parameters: Sequence[str]
) -> Figure:
    """Each measure over each parameter: all runs as points, medians or shares with their bands."""
    across, down = len(parameters), len(measures)
    figure = new_figure(1.2 + 2.3 * across, 1.2 + 1.7 * down)
    grid = figure.subplots(down, across, sharex="col", sharey="row", squeeze=False)
    figure.subplots_adjust(
        left=0.9 / (1.2 + 2.3 * across),
        right=0.98,
        hspace=0.12,
        wspace=0.1,
        bottom=0.75 / (1.2 + 1.7 * down),
        top=1 - 0.5 / (1.2 + 1.7 * down),
    )
    for line, measure in enumerate(measures):
        for column, parameter in enumerate(parameters):
            axes = grid[line, column]
            rows = [row for row in result.rows if row[measure] is not None]
            if is_numeric([row[parameter] for row in rows]):
                _draw_points(axes, rows, measure, parameter)
            _draw_line(axes, summarised(result, [parameter]), measure, parameter)
            tidy(axes)
            axes.tick_params(labelsize=7)
            if not column:
                _label_y(axes, result, measure, size=7)
            if line == down - 1:
                axes.set_xlabel(
                    label_of(result, parameter).replace(" (", "\n("), color=INK, fontsize=7
                )
                if _is_wide([row[parameter] for row in rows]):
                    _make_logarithmic(axes.xaxis)
    _title(figure, result, "All measures over all parameters")
    return figure


def _draw_points(axes: Axes, rows: Sequence[Any], measure: str, parameter: str) -> None:
    values = np.array([float(row[measure]) for row in rows])
    if is_share([row[measure] for row in rows]):
        # Truths lie on each other; a fixed spread shows how many there are.
        values = values + 0.06 * np.sin(np.arange(len(values)) * 2.4)
    x = np.array([float(row[parameter]) for row in rows])
    axes.plot(x, values, ".", color=FAINT, ms=3, alpha=0.6, zorder=1)


def label_of(result: "SweepResult", name: str) -> str:
    """A parameter, and whether it is truth, belief or both."""
    meaning = result.meanings.get(name)
    return f"{name} ({meaning})" if meaning else name


def _of(result: "SweepResult", measure: str) -> str:
    return f"Share {measure}" if _kind(result, measure) == "share" else f"Median {measure}"


def _kind(result: "SweepResult", measure: str) -> str:
    values = [row[measure] for row in result.rows if row[measure] is not None]
    return "share" if is_share(values) else "number" if is_numeric(values) else ""


def _values(result: "SweepResult", name: str) -> list[Any]:
    return list({repr(row[name]): row[name] for row in result.rows}.values())


def _is_grid(result: "SweepResult", x_name: str, y_name: str) -> bool:
    pairs = {(row[x_name], row[y_name]) for row in result.rows}
    return len(pairs) == len(_values(result, x_name)) * len(_values(result, y_name))


def _middle_key(row: Row, measure: str) -> str:
    keys = f"{measure}_share", f"{measure}_median"
    return next((key for key in keys if row.get(key) is not None), "")


def _column(rows: Sequence[Row], name: str) -> Floats:
    return np.array([row[name] for row in rows], dtype=float)


def _edges(values: Floats) -> Floats:
    """The edges of cells around values, in the middle between them."""
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    wide = _is_wide(values)
    scaled = np.log(values) if wide else values
    inner = 0.5 * (scaled[1:] + scaled[:-1])
    edges = np.concatenate(([2 * scaled[0] - inner[0]], inner, [2 * scaled[-1] - inner[-1]]))
    return np.array(np.exp(edges) if wide else edges, dtype=np.float64)


def _is_wide(values: Iterable[Any]) -> bool:
    """Whether values span so much that a logarithmic axis shows them, and their middle, better."""
    listed = [float(value) if isinstance(value, np.floating) else value for value in values]
    if not is_numeric(listed) or min(listed) <= 0 or max(listed) <= _WIDE * min(listed):
        return False
    return _off_middle(np.log(listed)) < _off_middle(np.array(listed))


def _off_middle(values: Floats) -> float:
    """How far the median is from the middle of the range, as a share of it."""
    low, high = float(values.min()), float(values.max())
    return abs(float(np.median(values)) - (low + high) / 2) / (high - low)


def _make_logarithmic(axis: Axis) -> None:
    """Have a logarithmic axis with plain numbers."""
    scale = axis.axes.set_xscale if isinstance(axis, XAxis) else axis.axes.set_yscale
    scale("log")
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _label_x(axes: Axes, result: "SweepResult", name: str) -> None:
    axes.set_xlabel(label_of(result, name), color=INK)
    values = _values(result, name)
    if _is_wide(values):
        _make_logarithmic(axes.xaxis)
    elif _has_bands(values):
        axes.xaxis.set_major_locator(MaxNLocator(7))
    tidy(axes)


def _label_y(axes: Axes, result: "SweepResult", measure: str, size: int = 10) -> None:
    axes.set_ylabel(measure, color=INK, fontsize=size)
    if _kind(result, measure) == "share":
        axes.set_ylim(-0.1, 1.1)
        axes.set_yticks([0.0, 0.5, 1.0] if size < 10 else np.linspace(0.0, 1.0, 6))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))


def _title(figure: Figure, result: "SweepResult", text: str, bands: str = "") -> None:
    width, height = figure.get_size_inches()
    left, top = 0.2 / width, 1 - 0.12 / height
    runs = f"{len(result.rows)} runs" + (f", {result.failed} failed" if result.failed else "")
    figure.text(left, top, text, color=INK, fontsize=11, weight="bold", va="top")
    if bands:
        runs = f"{runs}; {bands}"
    figure.text(left, top - 0.21 / height, runs, color=FAINT, fontsize=8, va="top")


def _broken(label: str, longest: int) -> str:
    """A parameter's label in lines: broken before its meaning, and at the dots of a long name."""
    lines = [""]
    for part in re.findall(r" \(.*|[^. ]+\.?", label):
        if part.startswith(" (") or (lines[-1] and len(lines[-1] + part) > longest):
            lines.append("")
        lines[-1] += part.lstrip()
    return "\n".join(lines)


def _short(value: Any) -> str:
    """A value as a label: of tables the values alone, a table a line."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list) and all(isinstance(each, dict) for each in value):
        return "\n".join(map(_short, value)) or "none"
    if isinstance(value, dict):
        parts = [_short(each) for each in value.values()]
        return _cut(" ".join(parts))
    return _cut(str(value))


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}\u2026"


def draw_tuning(tuned: "Tuned", objective: str) -> Figure:
    """The history of a tuning, and how much of the objective each key explains."""
    figure = new_figure(9.0, 4.0)
    history = figure.add_axes((0.09, 0.15, 0.48, 0.70))
    numbered = [(number, each) for number, each in enumerate(tuned.trials) if each.mean is not None]
    for within, face, label in ((True, COLOURS[0], "within bounds"), (False, "white", "beyond")):
        shown = [(number, each.mean) for number, each in numbered if each.is_within == within]
        if shown:
            history.plot(
                *zip(*shown, strict=True), "o", ms=5, mec=COLOURS[0], mfc=face, label=label
            )
    base = tuned.trials[0].mean
    if base is not None:
        history.axhline(base, color=FAINT, lw=1, ls="--", label="the scenario's own values")
    if tuned.best.mean is not None:
        number = list(tuned.trials).index(tuned.best)
        history.plot(number, tuned.best.mean, "*", color=COLOURS[1], ms=14, label="best", zorder=3)
    history.set_xlabel("trial", color=INK)
    history.set_ylabel(f"mean {objective}", color=INK)
    history.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    if numbered:
        history.legend(frameon=False, fontsize=8, labelcolor=INK)
    tidy(history)
    keys = figure.add_axes((0.78, 0.15, 0.19, 0.70))
    shares = sorted(tuned.importance.items(), key=lambda pair: pair[1])
    keys.barh([key for key, _ in shares], [share for _, share in shares], color=COLOURS[0])
    keys.set_xlabel("share explained", color=INK)
    tidy(keys)
    keys.tick_params(labelsize=7)
    left, top = 0.2 / 9.0, 1 - 0.12 / 4.0
    title = f"Tuning of {objective}"
    figure.text(left, top, title, color=INK, fontsize=11, weight="bold", va="top")
    return figure
