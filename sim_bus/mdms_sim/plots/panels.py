"""Quantities over time, one panel each, in the colours of the parcels."""

from collections.abc import Callable
from itertools import cycle
from typing import NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mdms_model.arrays import Floats
from mdms_model.run.colours import colours_of
from mdms_model.run.comings import exit_of
from mdms_model.run.planned import goals_at
from mdms_model.run.record import Record
from mdms_model.run.shared_belief import belief_error, cell_counts, host_error
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.neighbours import frames as wire
from mdms_sim.plots.canvas import FAINT, INK, tidy
from mdms_sim.plots.held_cells import tint
from mdms_sim.plots.scales import fit_values, label_time, mark_outside, shown_until_s

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
    """What there is to be seen of a run over time."""
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
    axes.set_xlim(record.time_s[0], shown_until_s(record))
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
