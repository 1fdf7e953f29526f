"""Position over time above the cells of a row, drawn as figures 7 to 9 of the paper.

Three traces for each parcel, its ends and its middle; each cell is a horizontal band at its
place, light grey without contact, medium grey while its wheel slides, black while it rolls.
"""

from itertools import pairwise

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from mdms_model.array import cell_centres
from mdms_model.arrays import Floats
from mdms_model.run.colours import parcel_colour
from mdms_model.run.record import Contact, Record
from mdms_model.scenario.scenario import Scenario
from mdms_sim.plots.canvas import FAINT, INK, label_time, limit_time, new_figure, tidy

BAND_SHARE = 0.34
BANDS = {"no contact": "#e3e6e9", "sliding": "#9aa1a8", "rolling": "#16191d"}
BAND_OF = {
    Contact.NONE: "no contact",
    Contact.ROLLING: "rolling",
    Contact.SLIDING_FORWARD: "sliding",
    Contact.SLIDING_BACKWARD: "sliding",
}


def draw_row(scenario: Scenario, record: Record) -> Figure:
    """The figure of a run on one row of cells."""
    figure = new_figure(10.0, 5.8)
    axes = figure.add_axes((0.08, 0.17, 0.85, 0.70))
    _draw_bands(axes, scenario, record)
    for number, parcel in enumerate(scenario.parcel):
        reach_m = parcel.length_m / 2 * np.cos(record.pose[:, number, 2])
        _draw_traces(axes, record.time_s, record.pose[:, number, 0], reach_m, number)
    _label(axes, scenario, record)
    _add_legend(figure, scenario)
    _add_titles(figure, scenario, record)
    return figure


def _draw_bands(axes: Axes, scenario: Scenario, record: Record) -> None:
    height_m = BAND_SHARE * scenario.array.pitch_m
    wheels = len(scenario.cell.wheel)
    for number, (x_m, _y_m) in enumerate(cell_centres(scenario.array)):
        contact = _of_cell(record.contact[:, number * wheels : (number + 1) * wheels])
        for state, spans in _spans(record.time_s, contact).items():
            if state is Contact.UNKNOWN:
                continue
            place = (x_m - height_m / 2, height_m)
            axes.broken_barh(spans, place, facecolor=BANDS[BAND_OF[state]], linewidth=0)


def _of_cell(contact: NDArray[np.int8]) -> NDArray[np.int8]:
    """One state per sample: that of the cell's first wheel which touches anything."""
    first = np.argmax(contact != Contact.NONE, axis=1)
    state: NDArray[np.int8] = contact[np.arange(len(contact)), first]
    return state


def _spans(time_s: Floats, states: NDArray[np.int8]) -> dict[Contact, list[tuple[float, float]]]:
    """Start and length of all stretches of each state, from sample to sample."""
    changes = np.flatnonzero(np.diff(states)) + 1
    spans: dict[Contact, list[tuple[float, float]]] = {}
    for start, end in pairwise([0, *changes.tolist(), len(states) - 1]):
        span = (float(time_s[start]), float(time_s[end] - time_s[start]))
        spans.setdefault(Contact(int(states[start])), []).append(span)
    return spans


def _draw_traces(axes: Axes, time_s: Floats, x_m: Floats, reach_m: Floats, number: int) -> None:
    """Both ends and the middle, haloed so that they stand out from black bands."""
    colour, halo = parcel_colour(number), [withStroke(linewidth=3.6, foreground="white")]
    for end_m in (x_m - reach_m, x_m + reach_m):
        axes.plot(time_s, end_m, color=colour, linewidth=1.3, path_effects=halo)
    axes.plot(time_s, x_m, color=colour, linewidth=2.2, path_effects=halo)


def _label(axes: Axes, scenario: Scenario, record: Record) -> None:
    half_m = scenario.array.columns * scenario.array.pitch_m / 2
    limit_time(axes, record)
    axes.set_ylim(-half_m, half_m)
    label_time(axes, record)
    axes.set_ylabel("position x [m]", color=INK)
    tidy(axes)
    cells = axes.secondary_yaxis("right")
    cells.set_yticks(
        cell_centres(scenario.array)[:, 0], [f"{i + 1}" for i in range(scenario.array.columns)]
    )
    cells.set_ylabel("cell", color=FAINT)
    cells.tick_params(length=0, labelsize=9, colors=FAINT)
    cells.spines["right"].set_visible(False)


def _add_legend(figure: Figure, scenario: Scenario) -> None:
    handles: list[Artist] = [Patch(facecolor=colour, label=name) for name, colour in BANDS.items()]
    for number, parcel in enumerate(scenario.parcel):
        colour, name = parcel_colour(number), parcel.name
        handles.append(Line2D([], [], color=colour, linewidth=2.2, label=f"middle of {name}"))
        handles.append(Line2D([], [], color=colour, linewidth=1.3, label=f"ends of {name}"))
    figure.legend(
        handles=handles,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.005),
        ncols=min(len(handles), 7),
        frameon=False,
        fontsize=9,
        labelcolor=INK,
    )


def _add_titles(figure: Figure, scenario: Scenario, record: Record) -> None:
    figure.text(0.08, 0.945, scenario.title, color=INK, fontsize=14, fontweight="bold")
    places = ", ".join(
        f"{parcel.name} at x = {x_m:.4f} m"
        for parcel, x_m in zip(scenario.parcel, record.pose[-1, :, 0], strict=True)
    )
    end = f"after {record.time_s[-1]:g} s {places}"
    motion = f"{scenario.motion.field} field, reference {scenario.motion.speed_m_s:g} m/s"
    figure.text(0.08, 0.9, f"{motion};  {end}", color=FAINT, fontsize=10)
