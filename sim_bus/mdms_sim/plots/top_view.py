"""The table from above: cells, wheels coloured by how often they slipped, exits, parcels' ways."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mdms_model.array import build_wheels, cell_centres, edge_m
from mdms_model.arrays import Floats
from mdms_model.outline import outline_m
from mdms_model.run.colours import colours_of
from mdms_model.run.planned import goals_at
from mdms_model.run.record import Contact, Record
from mdms_model.run.shared_belief import shared_belief
from mdms_model.scenario.scenario import Scenario
from mdms_sim.plots.canvas import INK, draw_as_map
from mdms_sim.plots.held_cells import HeldCells
from mdms_sim.plots.ways import draw_goal, draw_outline, draw_way, milestones

SLIP_COLOURS = LinearSegmentedColormap.from_list("slip", ["#2f6db5", "#9a5bb0", "#d6124a"])
#: Of what cells believe.
DASHED = (0, (2.5, 2))
NUMBER = "#6b7782"
UNTOUCHED = "#cfd5da"
EXIT, EXIT_M = "#5b6670", 0.012
MARGIN_M = 0.01
WHEEL_SHARE = 0.26


def draw_top_view(axes: Axes, scenario: Scenario, record: Record) -> None:
    """Fill the axes; one metre is as long along x as along y."""
    cells = HeldCells(axes, scenario.array)
    if record.identity is not None and record.state is not None:
        cells.show(record.identity[-1], record.state[-1])
    _number_cells(axes, scenario)
    draw_exits(axes, scenario)
    goals = goals_at(scenario, record, float(record.time_s[-1]))
    for number, (parcel, colour) in enumerate(
        zip(scenario.parcel, colours_of(scenario), strict=True)
    ):
        draw_way(axes, parcel, record.time_s, record.pose[:, number], colour)
        believed = shared_belief(record, number)[-1]
        if np.isfinite(believed).all():
            draw_outline(axes, parcel, believed, edgecolor=INK, linestyle=DASHED, lw=1.3, zorder=8)
        if parcel.name in goals:
            draw_goal(axes, parcel, goals[parcel.name])
    _draw_wheels(axes, scenario, record)
    low_m, high_m = extent_m(scenario, record)
    axes.set_xlim(low_m[0], high_m[0])
    axes.set_ylim(low_m[1], high_m[1])
    axes.set_xlabel("x [m]", color=INK, labelpad=1)
    axes.set_ylabel("y [m]", color=INK, labelpad=1)
    draw_as_map(axes)


def extent_m(scenario: Scenario, record: Record) -> tuple[Floats, Floats]:
    """Lower left and upper right of all there is to see: the table and the parcels on their way."""
    array = scenario.array
    seen_m = [np.array([array.columns, array.rows]) * array.pitch_m / 2]
    seen_m.append(-seen_m[0])
    for number, parcel in enumerate(scenario.parcel):
        pose = record.pose[:, number]
        for place in milestones(pose, parcel):
            seen_m.extend(outline_m(pose[place], parcel))
    return np.min(seen_m, axis=0) - MARGIN_M, np.max(seen_m, axis=0) + MARGIN_M


def add_wheels(axes: Axes, scenario: Scenario, width: float) -> LineCollection:
    """Each wheel as a short bar at its contact point, along the direction that it pushes."""
    wheels = build_wheels(scenario)
    reach_m = wheels.direction * scenario.array.pitch_m * WHEEL_SHARE / 2
    bars = np.stack((wheels.position_m - reach_m, wheels.position_m + reach_m), axis=1)
    collection = LineCollection(list(bars), linewidths=width, capstyle="round", zorder=4)
    axes.add_collection(collection)
    return collection


def draw_slip_scale(figure: Figure, box: tuple[float, float, float, float]) -> None:
    """What the wheels' colours mean, in a box (left, bottom, width, height) of the figure."""
    axes = figure.add_axes(box)
    axes.imshow(np.linspace(0, 1, 128)[None, :], cmap=SLIP_COLOURS, aspect="auto")
    axes.set_axis_off()
    axes.text(-4, 0, "wheel rolled", ha="right", va="center", fontsize=9, color=INK)
    axes.text(132, 0, "slipped whenever a parcel was on it", va="center", fontsize=9, color=INK)


def slip_share(contact: NDArray[np.int8]) -> Floats:
    """For each wheel the share of its time under parcels that it slipped; NaN if never under one.

    `contact` has shape (T, W), the result (W,).
    """
    sliding = (contact == Contact.SLIDING_FORWARD) | (contact == Contact.SLIDING_BACKWARD)
    touched = np.count_nonzero(sliding | (contact == Contact.ROLLING), axis=0)
    slipped = np.count_nonzero(sliding, axis=0)
    return np.where(touched > 0, slipped / np.maximum(touched, 1), np.nan)


def _number_cells(axes: Axes, scenario: Scenario) -> None:
    aside_m = 0.40 * scenario.array.pitch_m
    for number, place_m in enumerate(cell_centres(scenario.array), start=1):
        axes.annotate(f"{number}", tuple(place_m - aside_m), color=NUMBER, fontsize=7)


def _draw_wheels(axes: Axes, scenario: Scenario, record: Record) -> None:
    share = slip_share(record.contact)
    colours = [UNTOUCHED if np.isnan(value) else SLIP_COLOURS(value) for value in share]
    add_wheels(axes, scenario, 3.0).set_color(colours)


def draw_exits(axes: Axes, scenario: Scenario) -> None:
    """Where parcels leave: a line along the table's side, with the exit's name."""
    for each in scenario.exit:
        ends_m = edge_m(scenario.array, each.side, each.from_m, each.to_m)
        is_level = each.side in ("north", "south")
        sign = 1.0 if each.side in ("east", "north") else -1.0
        ends_m[:, int(is_level)] += sign * EXIT_M
        axes.plot(*ends_m.T, color=EXIT, lw=3.0, solid_capstyle="butt", clip_on=False, zorder=4)
        middle_m, turned = ends_m.mean(axis=0), 0 if is_level else -90
        kinds = f": {', '.join(each.kinds)}" if each.kinds else ""
        axes.annotate(
            f"{each.name}{kinds}",
            (float(middle_m[0]), float(middle_m[1])),
            xytext=(0, 7 * sign) if is_level else (7 * sign, 0),
            textcoords="offset points",
            rotation=turned,
            ha="center",
            va="center",
            fontsize=8,
            color=EXIT,
            annotation_clip=False,
        )
