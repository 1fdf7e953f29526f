"""A field on one row of cells: the force on a parcel along it."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_sim.physics.analysis.field_map import FieldMap
from mdms_sim.plots.canvas import FAINT, INK, new_figure, tidy
from mdms_sim.plots.fields.marks import MARKS, PULL, add_legend, free_of_push, marker_size, shade

#: How wide the axes are [points].
AXES_PT = 0.88 * 10.0 * 72


def draw_row(scenario: Scenario, parcel: Parcel, field: FieldMap, reference_m_s: Floats) -> Figure:
    """The figure, without its titles."""
    del parcel
    figure = new_figure(10.0, 5.4)
    axes = figure.add_axes((0.09, 0.20, 0.88, 0.62))
    force_n = field.force_n[0, :, 0]
    axes.axhline(0.0, color=FAINT, lw=0.9)
    axes.plot(field.x_m, force_n, color=PULL, lw=2.0)
    shade(axes, field.x_m, free_of_push(force_n))
    places_m = np.array([(rest.x_m, 0.0) for rest in field.places])
    points_per_m = AXES_PT / (field.x_m[-1] - field.x_m[0])
    for rest in field.places:
        marker, face, edge, _ = MARKS[rest.kind]
        size = marker_size(places_m, (rest.x_m, 0.0), points_per_m)
        axes.plot(rest.x_m, 0.0, marker, mfc=face, mec=edge, mew=size / 6, ms=size, zorder=8)
    _draw_row_wheels(axes, scenario, reference_m_s)
    axes.set_xlim(field.x_m[0], field.x_m[-1])
    axes.set_xlabel("x of the parcel's centre [m]", color=INK)
    axes.set_ylabel("net force [N]", color=INK)
    tidy(axes)
    add_legend(figure, field)
    return figure


def _draw_row_wheels(axes: Axes, scenario: Scenario, reference_m_s: Floats) -> None:
    """Each wheel at its place, with its reference."""
    share = reference_m_s / (abs(reference_m_s).max() or 1.0)
    places_m = build_wheels(scenario).position_m[:, 0]
    place = axes.get_xaxis_transform()
    for x_m, part in zip(places_m, share, strict=True):
        axes.plot(x_m, 0.03, "o", color="#7d8790", ms=6, transform=place)
        if part:
            tip = (x_m + 0.35 * scenario.array.pitch_m * part, 0.03)
            axes.annotate(
                "",
                tip,
                (x_m, 0.03),
                xycoords=place,
                arrowprops={"arrowstyle": "-|>", "color": "#3d464e", "lw": 1.4},
            )
