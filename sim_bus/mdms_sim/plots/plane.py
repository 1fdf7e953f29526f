"""A run in the plane at one glance: the table from above, and x, y and yaw over time.

Of a run that cells steered, with what they reported: at its end on the table, and over time how far
what they believed was off.
"""

from math import degrees, hypot, pi

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mdms_model.run.colours import parcel_colour
from mdms_model.run.record import Contact, Record
from mdms_model.run.shared_belief import has_layer
from mdms_model.scenario.scenario import Scenario, goal_of
from mdms_sim.plots.belief_panels import draw_belief_panels
from mdms_sim.plots.canvas import FAINT, INK, new_figure
from mdms_sim.plots.held_cells import held_legend
from mdms_sim.plots.pose_panels import draw_pose_panels
from mdms_sim.plots.top_view import DASHED, draw_slip_scale, draw_top_view, extent_m

WIDTH_IN, TOP_IN, BOTTOM_IN, ROW_IN = 13.0, 0.95, 1.0, 0.22
#: Of more parcels the legend names two only.
MOST_NAMED = 3
LEFT, MIDDLE, PANELS, RIGHT = 0.06, 0.60, 0.68, 0.985


def draw_plane(scenario: Scenario, record: Record) -> Figure:
    """The figure of a run on an array of any shape."""
    low_m, high_m = extent_m(scenario, record)
    width_m, depth_m = high_m - low_m
    view_in = (MIDDLE - LEFT) * WIDTH_IN * depth_m / width_m
    above_in = ROW_IN if has_layer(record) else 0.0
    bottom_in = BOTTOM_IN + above_in
    height_in = TOP_IN + bottom_in + min(max(view_in, 4.0), 8.0)
    figure = new_figure(WIDTH_IN, height_in)
    bottom, top = bottom_in / height_in, 1 - TOP_IN / height_in
    axes = figure.add_axes((LEFT, bottom, MIDDLE - LEFT, top - bottom))
    draw_top_view(axes, scenario, record)
    if (record.contact != Contact.UNKNOWN).any():
        draw_slip_scale(figure, (LEFT + 0.07, (0.2 + above_in) / height_in, 0.11, 0.12 / height_in))
    draw_panels = draw_belief_panels if has_layer(record) else draw_pose_panels
    draw_panels(figure, (PANELS, bottom, RIGHT - PANELS, top - bottom), scenario, record)
    _add_legend(figure, scenario, record)
    _add_titles(figure, height_in, scenario, record)
    return figure


def _add_legend(figure: Figure, scenario: Scenario, record: Record) -> None:
    handles: list[Artist] = []
    most = len(scenario.parcel) if len(scenario.parcel) <= MOST_NAMED else 2
    for number, parcel in enumerate(scenario.parcel[:most]):
        colour, name = parcel_colour(number), f"parcel {parcel.name}"
        handles.append(Patch(facecolor=f"{colour}55", edgecolor=colour, label=name))
    handles.append(Line2D([], [], color=FAINT, linestyle=(0, (1, 1.5)), lw=1.6, label="start"))
    if any(goal_of(scenario, parcel) for parcel in scenario.parcel):
        handles.append(Line2D([], [], color=INK, linestyle=(0, (4, 2)), label="goal"))
    if has_layer(record):
        label = "parcel as its cells believe"
        believed = Line2D([], [], color=INK, linestyle=DASHED, lw=1.3, label=label)
        _add_row(figure, [*held_legend(), believed], ROW_IN / figure.get_figheight())
    elif record.estimate is not None and np.isfinite(record.estimate).any():
        handles.append(Line2D([], [], color=INK, linewidth=1, label="as the coordinator believes"))
    _add_row(figure, handles, 0.0)


def _add_row(figure: Figure, handles: list[Artist], above: float) -> None:
    figure.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(RIGHT, 0.01 + above),
        ncols=len(handles),
        frameon=False,
        fontsize=9,
        labelcolor=INK,
    )


def _add_titles(figure: Figure, height_in: float, scenario: Scenario, record: Record) -> None:
    figure.text(
        LEFT, 1 - 0.42 / height_in, scenario.title, color=INK, fontsize=14, fontweight="bold"
    )
    lasting = np.flatnonzero(np.isfinite(record.pose).all(axis=(0, 2))).tolist()
    stories = [_story(scenario, record, number) for number in lasting[:2]]
    if len(lasting) > len(stories):
        stories.append(f"{len(lasting) - len(stories)} more")
    if scenario.stream:
        came, left = (
            sum(event.kind == kind for event in record.events) for kind in ("arrival", "exit")
        )
        stories.append(f"{came} parcels came, and {left} left")
    figure.text(LEFT, 1 - 0.72 / height_in, ";  ".join(stories), color=FAINT, fontsize=10)


def _story(scenario: Scenario, record: Record, number: int) -> str:
    """What became of a parcel, in one clause."""
    parcel, pose = scenario.parcel[number], record.pose[:, number]
    shift_m = hypot(*(pose[-1, :2] - pose[0, :2]))
    turn_deg = degrees(pose[-1, 2] - pose[0, 2])
    story = f"{parcel.name} moved {shift_m:.3f} m and turned {turn_deg:+.1f}°"
    tips = (
        event.time_s
        for event in record.events
        if event.kind == "tip" and event.parcel == parcel.name
    )
    if (tipped_s := next(tips, None)) is not None:
        return f"{story}; tipped off at {tipped_s:.2f} s"
    if (goal := goal_of(scenario, parcel)) is None:
        return story
    miss_m = hypot(pose[-1, 0] - goal.x_m, pose[-1, 1] - goal.y_m)
    miss_rad = (pose[-1, 2] - goal.yaw_rad + pi) % (2 * pi) - pi
    return f"{story}, {1000 * miss_m:.1f} mm and {abs(degrees(miss_rad)):.1f}° off its goal"
