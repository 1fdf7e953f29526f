"""All wheels over time, one stripe each: contact, normal force, friction force and slip.

The wheels of one axis stand together, those of the next above them. Of a run on hardware only
references and speeds are known.
"""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mdms_model.array import Wheels, build_wheels
from mdms_model.arrays import Floats
from mdms_model.run.derived import slip_m_s
from mdms_model.run.record import Contact, Record
from mdms_model.scenario.scenario import Scenario
from mdms_sim.plots.canvas import (
    FAINT,
    INK,
    label_time,
    limit_time,
    new_figure,
    share_outside,
    tidy,
    usual_most,
)

#: In the order of the codes of `Contact`; forward and backward are told apart by warmth.
CONTACT_COLOURS = ListedColormap(["#e3e6e9", "#16191d", "#d9795d", "#6d9fc9"])
CONTACT = "contact"
KNOWN = [contact for contact in Contact if contact is not Contact.UNKNOWN]
CONTACT_NAMES = [contact.name.lower().replace("_", "\n") for contact in KNOWN]
MOST_COLUMNS = 1500
#: A rolling wheel creeps by less.
LEAST_SLIP_M_S = 5e-3
STRIPE_IN, LEAST_PANEL_IN = 0.045, 1.25
LEFT, RIGHT, SCALE_WIDTH = 0.10, 0.88, 0.012


class WheelPanel(NamedTuple):
    """One quantity of all wheels (T, W), and its colours."""

    name: str
    values: Floats
    colours: Colormap | str
    norm: Normalize

    @property
    def extend(self) -> str:
        """Which ends of the scale some values lie beyond."""
        if self.name == CONTACT or not share_outside(self.values, float(self.norm.vmax or 1.0)):
            return "neither"
        return "max" if self.norm.vmin == 0.0 else "both"


def draw_wheels(scenario: Scenario, record: Record) -> Figure:
    """The figure: panels one above the other, with a stripe for each wheel."""
    wheels = build_wheels(scenario)
    panel_in = max(LEAST_PANEL_IN, STRIPE_IN * len(wheels.cell))
    panels = _panels(scenario, record)
    height_in = len(panels) * (panel_in + 0.25) + 1.15
    figure = new_figure(11.0, height_in)
    figure.text(
        LEFT, 1 - 0.45 / height_in, scenario.title, color=INK, fontsize=14, fontweight="bold"
    )
    order, axis = _by_axis(wheels)
    for part, panel in enumerate(panels):
        low_in = height_in - 0.55 - (part + 1) * (panel_in + 0.25)
        box = (LEFT, low_in / height_in, RIGHT - LEFT, panel_in / height_in)
        axes = figure.add_axes(box)
        _draw_stripes(axes, record.time_s, panel, order)
        limit_time(axes, record)
        _label(axes, panel.name, wheels.cell[order], axis)
        if part == len(panels) - 1:
            label_time(axes, record)
        else:
            axes.tick_params(labelbottom=False)
        scale = figure.add_axes((RIGHT + 0.015, box[1], SCALE_WIDTH, box[3]))
        paint = ScalarMappable(panel.norm, panel.colours)
        bar = figure.colorbar(paint, cax=scale, extend=panel.extend)
        if panel.name == CONTACT:
            bar.set_ticks(list(range(len(KNOWN))), labels=CONTACT_NAMES)
        scale.tick_params(labelsize=7, colors=INK)
    return figure


def _by_axis(wheels: Wheels) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """The wheels in the order of their stripes, by axis, then cell; the axis of each, from 1."""
    axis = np.arange(len(wheels.cell)) - wheels.first[wheels.cell] + 1
    order = np.lexsort((wheels.cell, axis))
    return order, axis[order]


def _panels(scenario: Scenario, record: Record) -> list[WheelPanel]:
    if (record.contact == Contact.UNKNOWN).all():
        return [
            _signed("reference [m/s]", record.reference_m_s),
            _signed("speed [m/s]", record.speed_m_s),
        ]
    kinds = BoundaryNorm(np.arange(len(KNOWN) + 1) - 0.5, len(KNOWN))
    most_n = usual_most(record.normal_n)
    return [
        WheelPanel(CONTACT, record.contact.astype(float), CONTACT_COLOURS, kinds),
        WheelPanel("normal [N]", record.normal_n, "YlGnBu", Normalize(0.0, most_n)),
        _signed("friction [N]", record.force_n),
        _signed("slip [m/s]", slip_m_s(scenario, record), LEAST_SLIP_M_S),
    ]


def _signed(name: str, values: Floats, least: float = 0.0) -> WheelPanel:
    most = usual_most(values, least)
    return WheelPanel(name, values, "RdBu_r", Normalize(-most, most))


def _draw_stripes(axes: Axes, time_s: Floats, panel: WheelPanel, order: NDArray[np.intp]) -> None:
    step = -(-len(time_s) // MOST_COLUMNS)
    axes.pcolormesh(
        np.append(time_s[:-1:step], time_s[-1]),
        np.arange(len(order) + 1),
        panel.values[:-1:step, order].T,
        cmap=panel.colours,
        norm=panel.norm,
    )


def _label(axes: Axes, name: str, cells: NDArray[np.int64], axis: NDArray[np.int64]) -> None:
    """Cells by number at the stripes, and which axis they are of; a line parts the axes."""
    tidy(axes)
    per_axis = int((axis == 1).sum())
    every = max(1, -(-per_axis // 6))
    marked = [row for row, cell in enumerate(cells.tolist()) if cell % every == 0]
    axes.set_yticks([row + 0.5 for row in marked], [str(cells[row] + 1) for row in marked])
    axes.tick_params(labelsize=7)
    axes.set_ylabel(name, color=INK, fontsize=9, labelpad=18 if axis[-1] > 1 else 2)
    for number in range(1, int(axis[-1]) + 1):
        rows = np.flatnonzero(axis == number)
        if number > 1:
            axes.axhline(rows[0], color=INK, lw=1.2)
        if axis[-1] > 1:
            axes.text(
                -0.045,
                rows.mean() + 0.5,
                f"axis {number}",
                transform=axes.get_yaxis_transform(),
                rotation=90,
                ha="center",
                va="center",
                fontsize=8,
                color=FAINT,
            )
