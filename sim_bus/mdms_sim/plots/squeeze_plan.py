"""A plan of squeezes: the squeeze function, angles left by each step, trials from above."""

from math import cos, degrees, isfinite, pi, sin
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from mdms_model.array import cell_centres
from mdms_model.arrays import Floats
from mdms_model.outline import area_and_moment, outline_m, own_outline_m
from mdms_model.run.colours import parcel_colour
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_model.squeeze import Squeeze, SqueezePlan
from mdms_sim.physics.squeeze_trials import (
    AS_PREDICTED_RAD,
    StepOutcome,
    Trials,
    final_error_rad,
    share_within,
    step_outcomes,
)
from mdms_sim.plots.canvas import FAINT, INK, draw_as_map, new_figure, tidy

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
    """Area of the part below a height, seen along `across`."""
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


WIDTH_IN, MOST_VIEWS = 15.0, 5
UNSTABLE, OPEN = "#c1272d", "#dbe7f3"


class Frame(NamedTuple):
    """How high panels reach, as shares of the figure."""

    top: float
    bottom: float


def draw_squeeze_plan(
    scenario: Scenario, parcel: Parcel, plan: SqueezePlan, trials: Trials | None
) -> Figure:
    """The figure of a plan for a parcel, and of trials on the array, if there are any."""
    height_in = 5.6 if trials is None else 8.2
    figure = new_figure(WIDTH_IN, height_in)
    count = f"{len(plan.steps)} squeeze{'s' * (len(plan.steps) > 1)}"
    title = f"{scenario.title}: {parcel.name} from any angle to one in {count}"
    figure.text(0.045, 1 - 0.42 / height_in, title, color=INK, fontsize=14, fontweight="bold")
    figure.text(0.045, 1 - 0.72 / height_in, _story(plan, trials), color=FAINT, fontsize=10)
    frame = Frame(1 - 1.25 / height_in, 0.95 / height_in)
    _draw_left(figure, plan, trials, frame)
    shown = plan.steps[:MOST_VIEWS]
    grid = figure.add_gridspec(
        1 if trials is None else 2,
        len(shown),
        left=0.40,
        right=0.985,
        top=frame.top,
        bottom=frame.bottom,
        wspace=0.06,
        hspace=0.16,
    )
    outcomes = [] if trials is None else step_outcomes(plan, trials)
    for column, step in enumerate(shown):
        draw_planned(figure.add_subplot(grid[0, column]), parcel, step, column + 1)
        if trials is not None:
            tried = figure.add_subplot(grid[1, column])
            draw_array(tried, scenario, step)
            draw_tried(tried, parcel, trials.pose[:, column + 1], outcomes[column])
    _add_legend(figure, trials)
    return figure


def _story(plan: SqueezePlan, trials: Trials | None) -> str:
    story = f"ends at yaw {degrees(plan.yaw_rad):.1f}°, or that and whole multiples of "
    story += f"{degrees(plan.function.period_rad):.4g}°"
    if isfinite(plan.margin_rad):
        story += f";  {degrees(plan.margin_rad):.1f}° to spare"
    if trials is not None:
        shares = (
            f"{share_within(final_error_rad(plan, trials), bound * pi / 180):.0%} within {bound}°"
            for bound in (5, 20)
        )
        story += f";  of {len(trials.pose)} random poses on this array {', '.join(shares)}"
    return story


# Squeeze function ---------------------------------------------------------------------------------


def _draw_left(figure: Figure, plan: SqueezePlan, trials: Trials | None, frame: Frame) -> None:
    """The function above the ranges, which share its angles; below both the trials."""
    middle = frame.bottom if trials is None else frame.bottom + 0.38 * (frame.top - frame.bottom)
    grid = figure.add_gridspec(
        2,
        1,
        height_ratios=[3.0, 0.6 + 0.4 * len(plan.steps)],
        left=0.06,
        right=0.345,
        top=frame.top,
        bottom=middle,
        hspace=0.12,
    )
    function = figure.add_subplot(grid[0])
    _draw_function(function, plan)
    _draw_ranges(figure.add_subplot(grid[1], sharex=function), plan)
    if trials is not None:
        height = 0.62 * (middle - frame.bottom)
        _draw_shares(figure.add_axes((0.06, frame.bottom, 0.285, height)), plan, trials)


def _draw_function(axes: Axes, plan: SqueezePlan) -> None:
    """From each angle to where it comes to rest; angles that rest lie on the diagonal."""
    function = plan.function
    base_deg, period_deg = degrees(function.unstable_rad[0]), degrees(function.period_rad)
    ends_deg = [*np.degrees(function.unstable_rad), base_deg + period_deg]
    axes.plot([base_deg, ends_deg[-1]], [base_deg, ends_deg[-1]], color=FAINT, lw=0.8, ls=":")
    for low_deg, high_deg, rest in zip(
        ends_deg[:-1], ends_deg[1:], function.stable_rad, strict=True
    ):
        rest_deg = degrees(rest)
        axes.plot([low_deg, high_deg], [rest_deg, rest_deg], color=LINE, lw=2.4)
        axes.plot(rest_deg, rest_deg, "o", mfc=NEAR, mec=NEAR, ms=8, zorder=5)
        axes.plot(low_deg, low_deg, "o", mfc="white", mec=UNSTABLE, mew=1.8, ms=8, zorder=5)
    axes.plot(ends_deg[-1], ends_deg[-1], "o", mfc="white", mec=UNSTABLE, mew=1.8, ms=8, zorder=5)
    axes.set_xlim(base_deg - 0.03 * period_deg, ends_deg[-1] + 0.03 * period_deg)
    axes.set_ylim(axes.get_xlim())
    axes.set_ylabel("comes to rest at [°]", color=INK)
    axes.set_title("Squeeze function", loc="left", color=INK, fontsize=11)
    axes.tick_params(labelbottom=False)
    tidy(axes)


def _draw_ranges(axes: Axes, plan: SqueezePlan) -> None:
    """Possible and actual angles of each step: it keeps away from the ends."""
    base_rad, period_rad = plan.function.unstable_rad[0], plan.function.period_rad
    before: Squeeze | None = None
    for row, step in enumerate(plan.steps):
        window = step.range
        low_rad, high_rad = (window.low_rad, window.high_rad)
        if before is None:
            low_rad, high_rad = base_rad, base_rad + period_rad
        for low, high in _wrapped(low_rad, high_rad, base_rad, period_rad):
            axes.barh(row, degrees(high - low), 0.62, degrees(low), color=OPEN, ec=PUSH, lw=0.8)
        if before is None:
            axes.text(
                degrees(base_rad + period_rad / 2), row, "any", color=INK, ha="center", va="center"
            )
        else:
            across = step.heading_rad - pi / 2
            angles = [base_rad + (across - y - base_rad) % period_rad for y in before.yaws_rad]
            axes.plot(np.degrees(angles), [row] * len(angles), "|", color=INK, ms=13, mew=2.2)
        before = step
    axes.set_ylim(len(plan.steps) - 0.5, -0.5)
    axes.set_yticks(range(len(plan.steps)), [f"{n + 1}" for n in range(len(plan.steps))])
    axes.set_ylabel("step", color=INK)
    axes.set_xlabel("direction of the push, seen from the polygon [°]", color=INK)
    tidy(axes)


def _wrapped(
    low_rad: float, high_rad: float, base_rad: float, period_rad: float
) -> list[tuple[float, float]]:
    """A range of angles as one or two pieces between `base_rad` and a period on."""
    shift = (low_rad - base_rad) // period_rad * period_rad
    low_rad, high_rad, end_rad = low_rad - shift, high_rad - shift, base_rad + period_rad
    if high_rad <= end_rad + 1e-9:
        return [(low_rad, high_rad)]
    return [(low_rad, end_rad), (base_rad, high_rad - period_rad)]


def _draw_shares(axes: Axes, plan: SqueezePlan, trials: Trials) -> None:
    """How many trials ended how near, for each step by itself and for the whole plan."""
    bounds_deg = np.linspace(0.0, min(45.0, degrees(plan.function.period_rad) / 2), 181)
    for step, outcome in enumerate(step_outcomes(plan, trials)):
        shares = [share_within(outcome.error_rad, bound * pi / 180) for bound in bounds_deg]
        axes.plot(
            bounds_deg, shares, lw=1.4, color=parcel_colour(step + 1), label=f"step {step + 1}"
        )
    error_rad = final_error_rad(plan, trials)
    shares = [share_within(error_rad, bound * pi / 180) for bound in bounds_deg]
    axes.plot(bounds_deg, shares, lw=2.6, color=INK, label="whole plan")
    axes.set_xlim(0.0, bounds_deg[-1])
    axes.set_ylim(0.0, 1.02)
    axes.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
    axes.set_xlabel("at most so far from the field without gaps [°]", color=INK)
    axes.set_ylabel("of all trials", color=INK)
    axes.set_title("Trials", loc="left", color=INK, fontsize=11)
    axes.legend(
        frameon=False,
        fontsize=9,
        loc="lower right",
        bbox_to_anchor=(1.01, 1.0),
        ncols=len(plan.steps) + 1,
        handlelength=1.2,
        columnspacing=1.2,
    )
    tidy(axes)


def _add_legend(figure: Figure, trials: Trials | None) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], ls="", marker="o", mfc=NEAR, mec=NEAR, ms=8, label="rests"),
        Line2D(
            *([], []),
            ls="",
            marker="o",
            mfc="white",
            mec=UNSTABLE,
            mew=1.8,
            ms=8,
            label="unstable",
        ),
        Patch(fc=OPEN, ec=PUSH, label="angles that the step brings together"),
        Line2D([], [], ls="", marker="|", color=INK, ms=12, mew=2.2, label="angles that come in"),
        Patch(fc=f"{PLANNED}30", ec=PLANNED, label="as planned, every angle that is left"),
    ]
    if trials is not None:
        handles.append(Line2D([], [], color=NEAR, label="trial within 5° of its prediction"))
        handles.append(Line2D([], [], color=FAINT, label="trial elsewhere"))
    figure.legend(
        handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=9
    )
