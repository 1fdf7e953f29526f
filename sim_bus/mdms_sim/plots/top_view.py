"""The table from above: cells and the parcels they report, wheels by slip, exits, ways."""

from colorsys import hls_to_rgb, rgb_to_hls
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import LinearSegmentedColormap, to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from mdms_model.array import build_wheels, cell_centres, edge_m
from mdms_model.arrays import Floats
from mdms_model.outline import outline_m
from mdms_model.run.colours import colours_of, parcel_colour
from mdms_model.run.derived import goals_at, shared_belief
from mdms_model.run.record import Contact, Record
from mdms_model.scenario.scenario import Array, Parcel, Scenario
from mdms_protocol.neighbours import frames as wire
from mdms_sim.plots.canvas import FAINT, INK, draw_as_map

FREE, FREE_EDGE = "#f3f5f7", "#dde2e6"
#: Of the pitch: room for the outline of a promised cell beside that of its neighbour.
SIDE_SHARE = 0.92
#: How much of a parcel's colour the square of a cell has.
NEAR_SHARE, UNDER_SHARE = 0.16, 0.45
PROMISED_WIDTH, PLAIN_WIDTH = 2.0, 0.8
_DARK = 0.7


def tint(colour: str, share: float) -> str:
    """A share of a colour on white; nothing shines through it."""
    red, green, blue = (1 - share * (1 - part) for part in to_rgb(colour))
    return to_hex((red, green, blue))


def dark(colour: str) -> str:
    """The colour for lines that lie on squares of it."""
    hue, light, saturation = rgb_to_hls(*to_rgb(colour))
    return to_hex(hls_to_rgb(hue, _DARK * light, saturation))


class HeldCells:
    """The squares of all cells in axes: near a parcel pale, promised outlined, under it filled."""

    def __init__(self, axes: Axes, array: Array) -> None:
        side_m = SIDE_SHARE * array.pitch_m
        corners_m = cell_centres(array) - side_m / 2
        squares = [Rectangle((x_m, y_m), side_m, side_m) for x_m, y_m in corners_m]
        self.squares = PatchCollection(squares, facecolors=FREE, edgecolors=FREE_EDGE)
        axes.add_collection(self.squares)

    def show(self, identity: NDArray[np.int8], state: NDArray[np.int8]) -> None:
        """Colour the squares by what each cell reports, both of shape (C,)."""
        looks = [_look(*held) for held in zip(identity.tolist(), state.tolist(), strict=True)]
        faces, edges, widths = zip(*looks, strict=True)
        self.squares.set_facecolor(faces)
        self.squares.set_edgecolor(edges)
        self.squares.set_linewidth(widths)


def held_legend() -> list[Artist]:
    """The meaning of the squares, in grey."""
    looks = {"under it": wire.UNDER, "promised to it": wire.PROMISED, "near it": wire.NEAR}
    return [
        Patch(facecolor=face, edgecolor=edge, linewidth=width, label=f"cell {name}")
        for name, state in looks.items()
        for face, edge, width in [_in_colour(FAINT, state)]
    ]


def _look(identity: int, state: int) -> tuple[str, str, float]:
    if not identity or state == wire.NONE:
        return FREE, FREE_EDGE, PLAIN_WIDTH
    return _in_colour(parcel_colour(identity - 1), state)


def _in_colour(colour: str, state: int) -> tuple[str, str, float]:
    """Face, edge and the edge's width [points]."""
    if state == wire.PROMISED:
        return "white", colour, PROMISED_WIDTH
    share = UNDER_SHARE if state == wire.UNDER else NEAR_SHARE
    return tint(colour, share), tint(colour, share + 0.1), PLAIN_WIDTH


START = (0, (1, 1.5))
FOOTPRINTS = 6
#: Times of outlines that are nearer than this to each other are not all written [m].
_APART_M = 0.03
_CREEP_M = 1e-3
_HALO = [withStroke(linewidth=2.2, foreground="white")]


def draw_way(axes: Axes, parcel: Parcel, time_s: Floats, pose: Floats, colour: str) -> None:
    """Footprints that grow stronger from start to end, with their times, and the centre's path.

    A parcel that comes and goes has no start and no end: its paths, and where it is at last.
    """
    if not np.isfinite(pose).all():
        axes.plot(pose[:, 0], pose[:, 1], color=colour, lw=0.9, alpha=0.6, zorder=6)
        if np.isfinite(pose[-1]).all():
            _draw_last(axes, parcel, pose[-1], colour)
        return
    chosen = milestones(pose, parcel)
    for place, strength in zip(chosen, np.linspace(0.25, 0.7, len(chosen)), strict=True):
        draw_outline(axes, parcel, pose[place], edgecolor=colour, lw=0.9, alpha=strength)
    draw_outline(axes, parcel, pose[0], edgecolor=colour, linestyle=START, lw=1.6)
    axes.add_patch(Polygon(nose_m(pose[0], parcel), facecolor=f"{colour}80", lw=0, zorder=6))
    axes.plot(pose[:, 0], pose[:, 1], color=colour, lw=2.0, zorder=6)
    axes.plot(*pose[0, :2], "o", color="white", markeredgecolor=colour, markersize=6, zorder=7)
    _draw_last(axes, parcel, pose[-1], colour)
    _write_times(axes, parcel, time_s[chosen], pose[chosen], colour)


def draw_goal(axes: Axes, parcel: Parcel, goal: Floats) -> None:
    """The outline at a goal (3,), and a cross in its middle; any turn will do where it is NaN."""
    pose = np.nan_to_num(goal)
    draw_outline(axes, parcel, pose, edgecolor=INK, linestyle=(0, (4, 2)), lw=1.4, zorder=8)
    axes.plot(*pose[:2], "+", color=INK, markersize=15, markeredgewidth=1.4, zorder=8)


def draw_outline(axes: Axes, parcel: Parcel, pose: Floats, **style: Any) -> None:
    """A parcel's outline at a pose."""
    corners = outline_m(pose, parcel)
    axes.add_patch(
        Polygon(corners, **{"facecolor": "none", "edgecolor": "none", "zorder": 5, **style})
    )


def write_name(axes: Axes, name: str, place_m: tuple[float, float], colour: str) -> Any:
    """A parcel's name in its middle, so that it can be read on anything; the text."""
    return axes.annotate(
        name,
        place_m,
        xytext=(0, 9),
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=8,
        fontweight="bold",
        color=colour,
        path_effects=_HALO,
        zorder=11,
        annotation_clip=True,
    )


def nose_m(pose: Floats, parcel: Parcel) -> Floats:
    """Corners of a slim triangle at the parcel's +x side, so that its turn can be seen.

    It is twice as long as wide, or it would seem to point with another of its corners.
    """
    tip, depth = parcel.length_m / 2, 0.14 * parcel.length_m
    turned = np.array([[np.cos(pose[2]), np.sin(pose[2])], [-np.sin(pose[2]), np.cos(pose[2])]])
    corners = np.array([(tip, 0.0), (tip - depth, depth / 4), (tip - depth, -depth / 4)])
    placed: Floats = corners @ turned + pose[:2]
    return placed


def milestones(pose: Floats, parcel: Parcel) -> list[int]:
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
    # A parcel that only creeps any more is there.
    wanted_m = np.linspace(0.0, max(way_m[-1] - _CREEP_M, 0.0), FOOTPRINTS)
    chosen = there[np.searchsorted(way_m, wanted_m).clip(0, len(pose) - 1)]
    return sorted(set(chosen.tolist()))


def _draw_last(axes: Axes, parcel: Parcel, pose: Floats, colour: str) -> None:
    draw_outline(axes, parcel, pose, facecolor=f"{colour}38", zorder=3)
    draw_outline(axes, parcel, pose, edgecolor=colour, lw=2.6)
    axes.add_patch(Polygon(nose_m(pose, parcel), facecolor=colour, lw=0, zorder=6))
    axes.plot(*pose[:2], "o", color=colour, markeredgecolor="white", markersize=9, zorder=7)
    write_name(axes, parcel.name, (float(pose[0]), float(pose[1])), colour)


def _write_times(axes: Axes, parcel: Parcel, times_s: Floats, poses: Floats, colour: str) -> None:
    """The time of each outline at that corner whose places are farthest apart."""
    corners_m = np.stack([outline_m(pose, parcel) for pose in poses])
    apart_m = np.hypot(*np.moveaxis(np.diff(corners_m, axis=0), 2, 0)).min(axis=0, initial=np.inf)
    best = int(np.argmax(apart_m))
    last_m = np.full(2, np.inf)
    for time_s, place_m in zip(times_s.tolist(), corners_m[:, best], strict=True):
        if np.hypot(*(place_m - last_m)) < _APART_M:
            continue
        last_m = place_m
        axes.annotate(
            f"{time_s:.1f} s",
            (float(place_m[0]), float(place_m[1])),
            fontsize=7.5,
            color=colour,
            ha="center",
            va="center",
            path_effects=_HALO,
            zorder=10,
        )


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
    """The meaning of the wheels' colours, in a box (left, bottom, width, height) of the figure."""
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
