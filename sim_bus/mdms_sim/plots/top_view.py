"""The table from above: cells, wheels coloured by how often they slipped, and parcels' ways."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from mdms_model.array import build_wheels, cell_centres
from mdms_model.arrays import Floats
from mdms_model.outline import outline_m
from mdms_model.run.colours import parcel_colour
from mdms_model.run.record import Contact, Record
from mdms_model.run.shared_belief import shared_belief
from mdms_model.scenario.scenario import Goal, Parcel, Scenario, goal_of
from mdms_sim.plots.canvas import INK, draw_as_map
from mdms_sim.plots.held_cells import HeldCells

SLIP_COLOURS = LinearSegmentedColormap.from_list("slip", ["#2f6db5", "#9a5bb0", "#d6124a"])
#: Of what cells believe.
DASHED = (0, (2.5, 2))
NUMBER = "#6b7782"
UNTOUCHED = "#cfd5da"
FOOTPRINTS = 6
MARGIN_M = 0.01
WHEEL_SHARE = 0.26


def draw_top_view(axes: Axes, scenario: Scenario, record: Record) -> None:
    """Fill the axes; one metre is as long along x as along y."""
    cells = HeldCells(axes, scenario.array)
    if record.identity is not None and record.state is not None:
        cells.show(record.identity[-1], record.state[-1])
    _number_cells(axes, scenario)
    for number, parcel in enumerate(scenario.parcel):
        _draw_way(axes, parcel, record.pose[:, number], parcel_colour(number))
        believed = shared_belief(record, number)[-1]
        if np.isfinite(believed).all():
            _draw_outline(axes, parcel, believed, edgecolor=INK, linestyle=DASHED, lw=1.3, zorder=8)
        if goal := goal_of(scenario, parcel):
            _draw_goal(axes, parcel, goal)
    _draw_wheels(axes, scenario, record)
    low_m, high_m = extent_m(scenario, record)
    axes.set_xlim(low_m[0], high_m[0])
    axes.set_ylim(low_m[1], high_m[1])
    axes.set_xlabel("x [m]", color=INK)
    axes.set_ylabel("y [m]", color=INK)
    draw_as_map(axes)


def extent_m(scenario: Scenario, record: Record) -> tuple[Floats, Floats]:
    """Lower left and upper right of all there is to see: the table and the parcels on their way."""
    array = scenario.array
    seen_m = [np.array([array.columns, array.rows]) * array.pitch_m / 2]
    seen_m.append(-seen_m[0])
    for number, parcel in enumerate(scenario.parcel):
        pose = record.pose[:, number]
        for place in _milestones(pose, parcel):
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


def nose_m(pose: Floats, parcel: Parcel) -> Floats:
    """Corners of a small triangle at the parcel's +x side, so that its turn can be seen."""
    tip, depth = parcel.length_m / 2, 0.09 * parcel.length_m
    turned = np.array([[np.cos(pose[2]), np.sin(pose[2])], [-np.sin(pose[2]), np.cos(pose[2])]])
    corners = np.array([(tip, 0.0), (tip - depth, depth / 2), (tip - depth, -depth / 2)])
    placed: Floats = corners @ turned + pose[:2]
    return placed


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


def _draw_way(axes: Axes, parcel: Parcel, pose: Floats, colour: str) -> None:
    """Footprints that grow stronger from start to end, and the path of the centre.

    One that comes and goes has no start and no end: its paths, and where it is at last.
    """
    if not np.isfinite(pose).all():
        axes.plot(pose[:, 0], pose[:, 1], color=colour, lw=0.8, alpha=0.5, zorder=6)
        if np.isfinite(pose[-1]).all():
            _draw_outline(axes, parcel, pose[-1], facecolor=f"{colour}38", zorder=3)
            _draw_outline(axes, parcel, pose[-1], edgecolor=colour, lw=2.6)
        return
    chosen = _milestones(pose, parcel)
    for place, strength in zip(chosen, np.linspace(0.25, 0.7, len(chosen)), strict=True):
        _draw_outline(axes, parcel, pose[place], edgecolor=colour, lw=0.9, alpha=strength)
    _draw_outline(axes, parcel, pose[0], edgecolor=colour, linestyle=(0, (1, 1.5)), lw=1.6)
    _draw_outline(axes, parcel, pose[-1], facecolor=f"{colour}38", zorder=3)
    _draw_outline(axes, parcel, pose[-1], edgecolor=colour, lw=2.6)
    _draw_nose(axes, pose[0], parcel, f"{colour}80")
    _draw_nose(axes, pose[-1], parcel, colour)
    axes.plot(pose[:, 0], pose[:, 1], color=colour, lw=2.0, zorder=6)
    axes.plot(*pose[0, :2], "o", color="white", markeredgecolor=colour, markersize=6, zorder=7)
    axes.plot(*pose[-1, :2], "o", color=colour, markeredgecolor="white", markersize=9, zorder=7)


def _draw_outline(axes: Axes, parcel: Parcel, pose: Floats, **style: Any) -> None:
    corners = outline_m(pose, parcel)
    axes.add_patch(
        Polygon(corners, **{"facecolor": "none", "edgecolor": "none", "zorder": 5, **style})
    )


def _draw_nose(axes: Axes, pose: Floats, parcel: Parcel, colour: str) -> None:
    axes.add_patch(Polygon(nose_m(pose, parcel), facecolor=colour, lw=0, zorder=6))


def _draw_goal(axes: Axes, parcel: Parcel, goal: Goal) -> None:
    pose = np.array([goal.x_m, goal.y_m, goal.yaw_rad])
    _draw_outline(axes, parcel, pose, edgecolor=INK, linestyle=(0, (4, 2)), lw=1.4, zorder=8)
    axes.plot(*pose[:2], "+", color=INK, markersize=15, markeredgewidth=1.4, zorder=8)


def _milestones(pose: Floats, parcel: Parcel) -> list[int]:
    """Samples evenly spread over the way made, so that a rest at the end adds none.

    None of a parcel that was never there.
    """
    there = np.flatnonzero(np.isfinite(pose).all(axis=1))
    if not len(there):
        return []
    pose = pose[there]
    reach_m = np.hypot(parcel.length_m, parcel.width_m) / 2
    steps_m = np.hypot(np.diff(pose[:, 0]), np.diff(pose[:, 1])) + reach_m * abs(
        np.diff(pose[:, 2])
    )
    way_m = np.concatenate(([0.0], np.cumsum(steps_m)))
    wanted_m = np.linspace(0.0, way_m[-1], FOOTPRINTS)
    chosen = there[np.searchsorted(way_m, wanted_m).clip(0, len(pose) - 1)]
    return sorted(set(chosen.tolist()))
