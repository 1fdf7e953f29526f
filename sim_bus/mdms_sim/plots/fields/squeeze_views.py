"""Top views of squeezes: a step as planned, and where trials are after it."""

from math import cos, degrees, sin

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Polygon

from mdms_model.array import cell_centres
from mdms_model.arrays import Floats
from mdms_model.outline import area_and_moment, outline_m, own_outline_m
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_model.squeeze.plan import Squeeze
from mdms_sim.physics.analysis.squeeze_outcome import (
    AS_PREDICTED_RAD,
    StepOutcome,
    share_within,
)
from mdms_sim.plots.canvas import FAINT, INK, draw_as_map

LINE, PUSH, NEAR, PLANNED = "#0b4a82", "#5a8fc0", "#009e73", "#d55e00"
ARROWS = 7


def draw_planned(axes: Axes, parcel: Parcel, step: Squeeze, number: int) -> None:
    """The line, the push to it, and every yaw that is left, up to the period."""
    reach_m = 1.25 * float(np.hypot(*own_outline_m(parcel).T).max())
    along = np.array([cos(step.heading_rad), sin(step.heading_rad)])
    across = np.array([-along[1], along[0]])
    axes.plot(*np.array([-reach_m * along, reach_m * along]).T, color=LINE, lw=1.6)
    for place in np.linspace(-0.9, 0.9, ARROWS) * reach_m:
        for side in (1.0, -1.0):
            tail = place * along + side * reach_m * across
            axes.annotate(
                "",
                tail - side * 0.3 * reach_m * across,
                tail,
                arrowprops={"arrowstyle": "-|>", "color": PUSH, "lw": 1.2},
            )
    many = len(step.yaws_rad) > 1
    for yaw_rad in step.yaws_rad:
        corners_m = _halved(parcel, yaw_rad, across)
        axes.add_patch(
            Polygon(corners_m, fc=f"{PLANNED}{'18' if many else '30'}", ec=PLANNED, lw=1.8)
        )
    _frame(axes, reach_m * 1.4, reach_m * 1.4)
    heading = f"{number}. line along {degrees(step.heading_rad):.1f}°"
    axes.set_title(heading, color=INK, fontsize=11, pad=4)


def _halved(parcel: Parcel, yaw_rad: float, across: Floats) -> Floats:
    """The parcel's corners where the line along x through 0, seen from `across`, halves it."""
    own_m = outline_m(np.array([0.0, 0.0, yaw_rad]), parcel)
    area_m2, moment_m3 = area_and_moment(own_m)
    heights_m = own_m @ across
    low_m, high_m = float(heights_m.min()), float(heights_m.max())
    for _ in range(40):
        middle_m = (low_m + high_m) / 2
        if _area_below(own_m, across, middle_m) < area_m2 / 2:
            low_m = middle_m
        else:
            high_m = middle_m
    along = np.array([across[1], -across[0]])
    centre_m = (moment_m3 / area_m2 @ along) * along
    return np.asarray(own_m - low_m * across - centre_m)


def _area_below(corners_m: Floats, across: Floats, height_m: float) -> float:
    """Area of what lies below a height, seen along `across`."""
    kept: list[Floats] = []
    for start, end in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        low, high = float(start @ across) - height_m, float(end @ across) - height_m
        if low <= 0.0:
            kept.append(start)
        if low * high < 0.0:
            kept.append(start + low / (low - high) * (end - start))
    return area_and_moment(np.array(kept))[0] if len(kept) > 2 else 0.0


def draw_array(axes: Axes, scenario: Scenario, step: Squeeze) -> None:
    """The cells, and the line of a step across them."""
    array = scenario.array
    pitch_m, half_m = array.pitch_m, np.array([array.columns, array.rows]) * array.pitch_m / 2
    square_m = 0.47 * pitch_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    squares = [centre_m + square_m for centre_m in cell_centres(array)]
    axes.add_collection(PolyCollection(squares, facecolors="none", edgecolors="#c9d1d8", lw=0.7))
    along_m = np.array([cos(step.heading_rad), sin(step.heading_rad)]) * float(np.hypot(*half_m))
    axes.plot(*np.array([-along_m, along_m]).T, color=LINE, lw=1.6)
    spare_m = max(0.15 * float(half_m.max()), 0.5 * pitch_m)
    _frame(axes, float(half_m[0]) + spare_m, float(half_m[1]) + spare_m)


def draw_tried(axes: Axes, parcel: Parcel, poses: Floats, outcome: StepOutcome) -> None:
    """Where the trials are after a step, those as predicted in another colour."""
    near = np.abs(outcome.error_rad) <= AS_PREDICTED_RAD
    for colour, chosen in ((FAINT, ~near & ~np.isnan(outcome.error_rad)), (NEAR, near)):
        rings = [outline_m(pose, parcel) for pose in poses[chosen]]
        closed = [np.vstack([ring, ring[:1]]) for ring in rings]
        axes.add_collection(LineCollection(closed, colors=colour, lw=0.8, alpha=0.6))
    gone = int(np.count_nonzero(np.isnan(outcome.error_rad)))
    share = share_within(outcome.error_rad, AS_PREDICTED_RAD)
    text = f"{share:.0%} within {degrees(AS_PREDICTED_RAD):.0f}° of the prediction"
    axes.set_title(f"{text}, {gone} have tipped" if gone else text, color=FAINT, fontsize=9)


def _frame(axes: Axes, half_x_m: float, half_y_m: float) -> None:
    draw_as_map(axes)
    axes.set_xlim(-half_x_m, half_x_m)
    axes.set_ylim(-half_y_m, half_y_m)
    axes.set_xticks([])
    axes.set_yticks([])
