"""A run in the plane at one glance: the table from above, and panels over time."""

from collections.abc import Callable
from itertools import cycle
from math import degrees, hypot, pi
from typing import NamedTuple, TypeAlias

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mdms_model.arrays import Floats
from mdms_model.run.colours import colours_of
from mdms_model.run.derived import belief_error, cell_counts, goals_at, host_error, lifted_s
from mdms_model.run.record import Contact, Record, exit_of
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.neighbours import frames as wire
from mdms_sim.plots.canvas import (
    FAINT,
    INK,
    fit_values,
    label_time,
    limit_time,
    mark_outside,
    new_figure,
    tidy,
)
from mdms_sim.plots.top_view import (
    START,
    draw_slip_scale,
    draw_top_view,
    extent_m,
    held_legend,
    tint,
)

POSES = (("x [m]", 1.0, 0.02), ("y [m]", 1.0, 0.02), ("yaw [°]", 180 / np.pi, 4.0))
ERRORS = (("belief off by [mm]", 1e3, 1.0), ("belief off by [°]", 180 / np.pi, 0.5))
#: Of the counts, from below; the same greys as in the legend of the cells.
COUNTS = {
    wire.UNDER: ("under a parcel", tint(FAINT, 0.9)),
    wire.PROMISED: ("promised", tint(FAINT, 0.5)),
    wire.NEAR: ("near", tint(FAINT, 0.16)),
}
DASHED, GOAL = (0, (2.5, 1.5)), (0, (4, 2))
#: How far the names of panels are to their left [in].
NAME_IN = 0.58
YAW, TURN = 2, 2 * np.pi
_NO_GOAL = np.full(3, np.nan)


class Panel(NamedTuple):
    """One quantity: draws itself into axes."""

    name: str
    draw: Callable[[Axes], None]


#: How far a belief of parcel `number` is off, by the record: (T, 2) [m, rad].
Error: TypeAlias = Callable[[int], Floats]


def panels_of(scenario: Scenario, record: Record) -> list[Panel]:
    """The views of a run over time."""
    panels = []
    if scenario.stream:
        if any(event.kind == "exit" for event in record.events):
            panels.append(Panel("have left", lambda axes: _draw_left(axes, scenario, record)))
        panels.append(Panel("on the table", lambda axes: _draw_there(axes, record)))
    else:
        for part, (name, _, _) in enumerate(POSES):
            panels.append(Panel(name, _pose_panel(scenario, record, part)))
    for part, (name, _, _) in enumerate(ERRORS if _has_errors(record) else ()):
        panels.append(Panel(name, _error_panel(scenario, record, part)))
    if record.identity is not None:
        panels.append(Panel("cells", lambda axes: _draw_counts(axes, record)))
    return panels


def draw_panel(axes: Axes, panel: Panel, record: Record, *, is_last: bool) -> None:
    """One panel, with its time named if it is the last of its column."""
    limit_time(axes, record)
    panel.draw(axes)
    axes.set_ylabel(panel.name, color=INK, fontsize=9)
    tidy(axes)
    axes.tick_params(labelsize=8)
    figure = axes.get_figure(root=True)
    if figure is not None:
        # Names stand in line, whatever the numbers beside them.
        width_in = axes.get_position().width * figure.get_figwidth()
        axes.yaxis.set_label_coords(-NAME_IN / width_in, 0.5)
    if is_last:
        label_time(axes, record)
    else:
        axes.tick_params(labelbottom=False)


def _has_errors(record: Record) -> bool:
    if record.is_belief:
        return False
    known = record.estimate is not None and bool(np.isfinite(record.estimate).any())
    return known or record.identity is not None


def _pose_panel(scenario: Scenario, record: Record, part: int) -> Callable[[Axes], None]:
    _, factor, least = POSES[part]
    colours = colours_of(scenario)

    def draw(axes: Axes) -> None:
        goals = goals_at(scenario, record, float(record.time_s[-1]))
        shown = [record.pose[:, :, part].ravel() * factor]
        for number, parcel in enumerate(scenario.parcel):
            colour = colours[number]
            axes.plot(record.time_s, record.pose[:, number, part] * factor, color=colour, lw=2.0)
            goal = goals.get(parcel.name, _NO_GOAL)[part]
            last = record.pose[-1, number, part]
            if np.isfinite(goal) and np.isfinite(last):
                # In the turn that the parcel has made.
                goal += TURN * np.round((last - goal) / TURN) if part == YAW else 0.0
                axes.axhline(goal * factor, color=colour, lw=1.0, linestyle=GOAL)
                shown.append(np.array([goal * factor]))
        fit_values(axes, np.concatenate(shown), least)

    return draw


def _error_panel(scenario: Scenario, record: Record, part: int) -> Callable[[Axes], None]:
    _, factor, least = ERRORS[part]
    colours = colours_of(scenario)

    def draw(axes: Axes) -> None:
        lines = [
            (number, style, off)
            for number, parcel in enumerate(scenario.parcel)
            for style, error in (
                ("-", host_error(scenario, record, number)),
                (DASHED, belief_error(record, number, parcel)),
            )
            for off in [error[:, part] * factor]
            if np.isfinite(off).any()
        ]
        for number, style, off in lines:
            axes.plot(record.time_s, off, color=colours[number], lw=1.3, linestyle=style)
        together = np.concatenate([off for *_, off in lines]) if lines else np.zeros(1)
        fit_values(axes, np.append(together, 0.0), least)
        axes.set_ylim(bottom=0.0)
        mark_outside(axes, record.time_s, [(off, colours[n]) for n, _, off in lines])

    return draw


def _draw_counts(axes: Axes, record: Record) -> None:
    counts = [cell_counts(record)[state] for state in COUNTS]
    axes.stackplot(
        record.time_s,
        *counts,
        labels=[name for name, _ in COUNTS.values()],
        colors=[colour for _, colour in COUNTS.values()],
    )
    axes.set_ylim(0.0, 1.35 * max(1.0, np.sum(counts, axis=0).max()))
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.legend(loc="upper right", ncols=len(COUNTS), frameon=False, fontsize=7, labelcolor=INK)


def _draw_left(axes: Axes, scenario: Scenario, record: Record) -> None:
    """How many parcels have left by each exit."""
    for each, style in zip(scenario.exit, cycle(("-", DASHED, (0, (1, 1)), "-.")), strict=False):
        times_s = [
            event.time_s
            for event in record.events
            if event.kind == "exit" and exit_of(event) == each.name
        ]
        steps_s = np.concatenate(([record.time_s[0]], times_s, [record.time_s[-1]]))
        counts = np.concatenate((np.arange(len(times_s) + 1), [len(times_s)]))
        label = f"{each.name}: {len(times_s)}"
        axes.step(steps_s, counts, where="post", color=INK, lw=1.4, linestyle=style, label=label)
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.legend(loc="upper left", frameon=False, fontsize=8, labelcolor=INK, handlelength=2.5)


def _draw_there(axes: Axes, record: Record) -> None:
    there = np.isfinite(record.pose).all(axis=2).sum(axis=1)
    axes.fill_between(record.time_s, there, step="post", color=tint(FAINT, 0.5), lw=0)
    axes.set_ylim(0, 1.15 * max(int(there.max()), 1))
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))


WIDTH_IN, TOP_IN, EDGE_IN, GAP_IN = 13.0, 0.85, 0.75, 0.85
#: A table so many times as long as it is deep, or of so many columns, has all panels below it.
LONG, MANY_COLUMNS = 2.2, 12
#: Beside panels a table takes so much of the width, and so much height at most [in].
BESIDE_IN, DEEPEST_IN = 7.0, 7.5
PANEL_IN, PANEL_GAP_IN, COLUMNS = 1.0, 0.22, 3
TICKS_IN, LEGEND_ROW_IN, SCALE_IN = 0.55, 0.24, 0.3
#: The legend names no more parcels.
MOST_NAMED = 12
_LETTER_IN, _SIGN_IN = 0.075, 0.55


class Box(NamedTuple):
    """A part of a figure, from its top left corner [in]."""

    left: float
    top: float
    width: float
    height: float


def draw_plane(scenario: Scenario, record: Record) -> Figure:
    """The figure of a run on an array of any shape."""
    panels, legend = panels_of(scenario, record), _legend(scenario, record)
    low_m, high_m = extent_m(scenario, record)
    shape = (high_m[1] - low_m[1]) / (high_m[0] - low_m[0])
    is_long = shape * LONG < 1.0 or scenario.array.columns >= MANY_COLUMNS
    width_in = WIDTH_IN - 1.4 * EDGE_IN
    view_in = width_in if is_long else min(BESIDE_IN, DEEPEST_IN / shape)
    view = Box(EDGE_IN, TOP_IN, view_in, view_in * shape)
    rows = _rows(legend, view.width)
    below_in = view.top + view.height + TICKS_IN
    has_scale = bool((record.contact != Contact.UNKNOWN).any())
    used_in = below_in + SCALE_IN * has_scale + LEGEND_ROW_IN * len(rows) + 0.15
    if is_long:
        columns = _across(len(panels), Box(EDGE_IN, used_in + 0.15, width_in, PANEL_IN))
    else:
        columns = _beside(len(panels), view, used_in, width_in)
    boxes = [box for column in columns for box in column]
    figure = new_figure(
        WIDTH_IN, max([used_in, *(box.top + box.height + TICKS_IN for box in boxes)])
    )
    draw_top_view(figure.add_axes(_shares(figure, view)), scenario, record)
    if has_scale:
        draw_slip_scale(figure, _shares(figure, Box(view.left + 0.95, below_in + 0.08, 1.3, 0.12)))
    for number, row in enumerate(rows):
        _add_row(figure, row, view.left, below_in + SCALE_IN * has_scale + LEGEND_ROW_IN * number)
    lowest = [column[-1] for column in columns if column]
    for panel, box in zip(panels, boxes, strict=True):
        axes = figure.add_axes(_shares(figure, box))
        draw_panel(axes, panel, record, is_last=box in lowest)
    _add_titles(figure, scenario, record)
    return figure


def _shares(figure: Figure, box: Box) -> tuple[float, float, float, float]:
    """Left, bottom, width and height, as matplotlib has them."""
    width_in, height_in = figure.get_size_inches().tolist()
    bottom_in = height_in - box.top - box.height
    return (
        box.left / width_in,
        bottom_in / height_in,
        box.width / width_in,
        box.height / height_in,
    )


def _beside(count: int, view: Box, used_in: float, width_in: float) -> list[list[Box]]:
    """Boxes in a column beside the table and, where that grows too high, some below it."""
    step_in = PANEL_IN + PANEL_GAP_IN
    # The time's own line is needed on both sides.
    heights = [
        max(TOP_IN + (count - below) * step_in, used_in + below * step_in + TICKS_IN * (below > 0))
        for below in range(count)
    ]
    below = int(np.argmin(heights)) if count else 0
    left_in = view.left + view.width + GAP_IN
    room_in = max(heights[below] if count else 0.0, used_in) - TOP_IN - TICKS_IN * (below > 0)
    width_in -= left_in - EDGE_IN
    return [
        _column(count - below, Box(left_in, TOP_IN, width_in, room_in)),
        _column(below, Box(view.left, used_in + 0.1, view.width, below * step_in)),
    ]


def _column(count: int, room: Box) -> list[Box]:
    """Boxes one above the other."""
    step_in = room.height / max(count, 1)
    height_in = step_in - PANEL_GAP_IN
    return [Box(room.left, room.top + n * step_in, room.width, height_in) for n in range(count)]


def _across(count: int, first: Box) -> list[list[Box]]:
    """Boxes in rows of `COLUMNS`, by column."""
    step_in = (first.width + GAP_IN) / COLUMNS
    width_in, down_in = step_in - GAP_IN, first.height + PANEL_GAP_IN
    return [
        [
            Box(first.left + column * step_in, first.top + n * down_in, width_in, first.height)
            for n in range(len(range(column, count, COLUMNS)))
        ]
        for column in range(COLUMNS)
    ]


def _legend(scenario: Scenario, record: Record) -> list[Artist]:
    handles: list[Artist] = []
    by_name = {
        (parcel.kind or parcel.name) if scenario.stream else parcel.name: colour
        for parcel, colour in zip(scenario.parcel, colours_of(scenario), strict=True)
    }
    for name, colour in list(by_name.items())[:MOST_NAMED]:
        handles.append(Patch(facecolor=f"{colour}55", edgecolor=colour, label=name))
    if len(by_name) > MOST_NAMED:
        more = f"and {len(by_name) - MOST_NAMED} more"
        handles.append(Patch(facecolor="none", edgecolor="none", label=more))
    if not scenario.stream:
        handles.append(Line2D([], [], color=FAINT, linestyle=START, lw=1.6, label="start"))
    if goals_at(scenario, record, float(record.time_s[-1])):
        handles.append(Line2D([], [], color=INK, linestyle=GOAL, label="goal"))
    if record.identity is not None:
        handles += held_legend()
        handles.append(Line2D([], [], color=INK, lw=1.3, label="belief of the host"))
        label = "of its cells"
        handles.append(Line2D([], [], color=INK, linestyle=DASHED, lw=1.3, label=label))
    return handles


def _rows(handles: list[Artist], width_in: float) -> list[list[Artist]]:
    """The legend in lines that are no longer than this."""
    rows: list[list[Artist]] = [[]]
    left_in = width_in
    for handle in handles:
        needed_in = _SIGN_IN + _LETTER_IN * len(str(handle.get_label()))
        if needed_in > left_in and rows[-1]:
            rows.append([])
            left_in = width_in
        rows[-1].append(handle)
        left_in -= needed_in
    return rows


def _add_row(figure: Figure, handles: list[Artist], left_in: float, top_in: float) -> None:
    width_in, height_in = figure.get_size_inches().tolist()
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=((left_in + 0.05) / width_in, 1 - top_in / height_in),
        ncols=max(len(handles), 1),
        frameon=False,
        fontsize=9,
        labelcolor=INK,
        borderpad=0.0,
        borderaxespad=0.0,
        handlelength=1.8,
        columnspacing=1.4,
    )


def _add_titles(figure: Figure, scenario: Scenario, record: Record) -> None:
    width_in, height_in = figure.get_size_inches().tolist()
    left, title = EDGE_IN / width_in, scenario.title
    figure.text(left, 1 - 0.38 / height_in, title, color=INK, fontsize=14, fontweight="bold")
    lasting = np.flatnonzero(np.isfinite(record.pose).all(axis=(0, 2))).tolist()
    stories = [_story(scenario, record, number) for number in lasting[:2]]
    if len(lasting) > len(stories):
        stories.append(f"{len(lasting) - len(stories)} more")
    came, left_table = (
        sum(event.kind == kind for event in record.events) for kind in ("arrival", "exit")
    )
    # Nobody counts them on hardware.
    if came:
        stories.append(f"{came} parcels came, and {left_table} left")
    figure.text(left, 1 - 0.66 / height_in, ";  ".join(stories), color=FAINT, fontsize=10)


def _story(scenario: Scenario, record: Record, number: int) -> str:
    """The fate of a parcel, in one clause."""
    parcel, pose = scenario.parcel[number], record.pose[:, number]
    shift_m = hypot(*(pose[-1, :2] - pose[0, :2]))
    turn_deg = degrees(pose[-1, 2] - pose[0, 2])
    story = f"{parcel.name} moved {shift_m:.3f} m and turned {turn_deg:+z.1f}°"
    tips = (
        event.time_s
        for event in record.events
        if event.kind == "tip" and event.parcel == parcel.name
    )
    if (tipped_s := next(tips, None)) is not None:
        return f"{story}; tipped off at {tipped_s:.2f} s"
    if (since_s := lifted_s(record, parcel.name)) is not None:
        return f"{story}; lifted off the table at {since_s:.2f} s"
    goal = goals_at(scenario, record, float(record.time_s[-1])).get(parcel.name)
    if goal is None:
        return story
    miss_mm = 1000 * hypot(*(pose[-1, :2] - goal[:2]))
    if np.isnan(goal[2]):
        return f"{story}, {miss_mm:.1f} mm off its goal"
    miss_rad = (pose[-1, 2] - goal[2] + pi) % (2 * pi) - pi
    return f"{story}, {miss_mm:.1f} mm and {abs(degrees(miss_rad)):.1f}° off its goal"
