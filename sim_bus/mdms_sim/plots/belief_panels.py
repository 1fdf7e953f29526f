"""How far the cells' belief of each parcel is off over time, and how many cells are at parcels."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mdms_model.run.colours import parcel_colour
from mdms_model.run.record import Record
from mdms_model.run.shared_belief import belief_error, cell_counts
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.neighbours import frames as wire
from mdms_sim.plots.canvas import FAINT, INK, tidy
from mdms_sim.plots.held_cells import tint

PARTS = (("belief off by [mm]", 1e3, 2.0), ("belief off by [°]", 180 / np.pi, 1.0))
GAP_SHARE = 0.12
#: Of the counts, from below; the same greys as in the legend of the cells.
COUNTS = {
    wire.UNDER: ("under a parcel", tint(FAINT, 0.9)),
    wire.PROMISED: ("promised", tint(FAINT, 0.5)),
    wire.NEAR: ("near", tint(FAINT, 0.16)),
}


def draw_belief_panels(
    figure: Figure, box: tuple[float, float, float, float], scenario: Scenario, record: Record
) -> None:
    """Three panels, one above the other, in a box (left, bottom, width, height) of the figure."""
    left, bottom, width, height = box
    step = height / (len(PARTS) + 1)
    lows = [bottom + height - (part + 1) * step for part in range(len(PARTS) + 1)]
    panels = [figure.add_axes((left, low, width, step * (1 - GAP_SHARE))) for low in lows]
    for part, axes in enumerate(panels[:-1]):
        _draw_errors(axes, scenario, record, part)
        axes.tick_params(labelbottom=False)
    _draw_counts(panels[-1], record)
    for axes in panels:
        axes.set_xlim(record.time_s[0], record.time_s[-1])
        axes.yaxis.set_major_locator(MaxNLocator(5, prune="upper", integer=axes is panels[-1]))
        tidy(axes)
    panels[-1].set_xlabel("time [s]", color=INK)


def _draw_errors(axes: Axes, scenario: Scenario, record: Record, part: int) -> None:
    name, factor, least = PARTS[part]
    most = least
    for number, parcel in enumerate(scenario.parcel):
        off = belief_error(record, number, parcel)[:, part] * factor
        axes.plot(record.time_s, off, color=parcel_colour(number), lw=1.8)
        most = max(most, 1.05 * np.max(off, initial=0.0, where=np.isfinite(off)))
    axes.set_ylim(0.0, most)
    axes.set_ylabel(name, color=INK, fontsize=9)


def _draw_counts(axes: Axes, record: Record) -> None:
    counts = [cell_counts(record)[state] for state in COUNTS]
    axes.stackplot(
        record.time_s,
        *counts,
        labels=[name for name, _ in COUNTS.values()],
        colors=[colour for _, colour in COUNTS.values()],
    )
    axes.set_ylim(0.0, 1.3 * max(1.0, np.sum(counts, axis=0).max()))
    axes.set_ylabel("cells", color=INK, fontsize=9)
    axes.legend(loc="upper right", ncols=len(COUNTS), frameon=False, fontsize=8, labelcolor=INK)
