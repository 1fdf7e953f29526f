"""The way of a parcel over the table: its outlines with their times, its path, and its goal."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

from mdms_model.arrays import Floats
from mdms_model.outline import outline_m
from mdms_model.scenario.scenario import Parcel
from mdms_sim.plots.canvas import INK

START = (0, (1, 1.5))
FOOTPRINTS = 6
#: Times of outlines that are nearer than this to each other are not all written [m].
_APART_M = 0.03
_CREEP_M = 1e-3
_HALO = [withStroke(linewidth=2.2, foreground="white")]


def draw_way(axes: Axes, parcel: Parcel, time_s: Floats, pose: Floats, colour: str) -> None:
    """Footprints that grow stronger from start to end, with their times, and the centre's path.

    One that comes and goes has no start and no end: its paths, and where it is at last.
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
    """Corners of a small triangle at the parcel's +x side, so that its turn can be seen."""
    tip, depth = parcel.length_m / 2, 0.09 * parcel.length_m
    turned = np.array([[np.cos(pose[2]), np.sin(pose[2])], [-np.sin(pose[2]), np.cos(pose[2])]])
    corners = np.array([(tip, 0.0), (tip - depth, depth / 2), (tip - depth, -depth / 2)])
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
