"""One frame of an animation: the table from above at an instant, with what cells report."""

from io import BytesIO
from math import degrees
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.text import Text
from numpy.typing import NDArray

from mdms_model.outline import outline_m
from mdms_model.run.colours import parcel_colour
from mdms_model.run.record import Record
from mdms_model.run.shared_belief import belief_error, shared_belief
from mdms_model.scenario.scenario import Scenario, goal_of
from mdms_sim.plots.canvas import FAINT, INK, draw_as_map, new_figure
from mdms_sim.plots.held_cells import HeldCells, dark, held_legend
from mdms_sim.plots.top_view import DASHED, add_wheels, extent_m
from mdms_sim.plots.ways import nose_m

WIDTH_IN, WIDTH_PX = 6.4, 640
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN = 0.55, 0.12, 0.62, 0.92
#: How many parcels the caption has room for.
MOST_TOLD = 2
#: A longer title is smaller.
MOST_LETTERS = 56
#: A wheel whose surface is faster turns [m/s].
TURNS_M_S = 0.004
TURNING, STILL = "#39434d", "#c3cad0"
DOTTED = (0, (1, 1.2))


class MovingView:
    """The figure of a run that cells steered, drawn anew for each instant; `times` as fast."""

    def __init__(self, scenario: Scenario, record: Record, times: float = 1.0) -> None:
        self._scenario, self._record = scenario, record
        low_m, high_m = extent_m(scenario, record)
        width_in = WIDTH_IN - LEFT_IN - RIGHT_IN
        view_in = width_in * (high_m[1] - low_m[1]) / (high_m[0] - low_m[0])
        self._height_in = TOP_IN + view_in + BOTTOM_IN
        self._figure = figure = new_figure(WIDTH_IN, self._height_in)
        axes = figure.add_axes(
            (
                LEFT_IN / WIDTH_IN,
                BOTTOM_IN / self._height_in,
                width_in / WIDTH_IN,
                view_in / self._height_in,
            )
        )
        self._cells = HeldCells(axes, scenario.array)
        self._wheels = add_wheels(axes, scenario, 2.0)
        self._parcels = [
            _MovingParcel(axes, scenario, record, number) for number in range(len(scenario.parcel))
        ]
        axes.set_xlim(low_m[0], high_m[0])
        axes.set_ylim(low_m[1], high_m[1])
        axes.set_xlabel("x [m]", color=INK, fontsize=9, labelpad=1)
        axes.set_ylabel("y [m]", color=INK, fontsize=9, labelpad=1)
        draw_as_map(axes)
        axes.tick_params(labelsize=8)
        self._time, self._caption = self._add_titles(times)
        self._add_legend()
        for text in figure.findobj(Text):
            text.set_parse_math(False)

    def pixels(self, instant: int) -> NDArray[np.uint8]:
        """The frame of a sample of the record, of shape (height, width, 3)."""
        record = self._record
        if record.identity is not None and record.state is not None:
            self._cells.show(record.identity[instant], record.state[instant])
        turning = abs(record.speed_m_s[instant]) > TURNS_M_S
        self._wheels.set_color([TURNING if turns else STILL for turns in turning])
        for parcel in self._parcels:
            parcel.show(instant)
        told = [parcel.story(instant) for parcel in self._parcels[:MOST_TOLD]]
        if len(self._parcels) > MOST_TOLD:
            told.append(f"{len(self._parcels) - MOST_TOLD} more")
        self._time.set_text(f"{record.time_s[instant]:.1f} s")
        self._caption.set_text("     ".join(told))
        raw = BytesIO()
        self._figure.savefig(raw, format="raw", dpi=WIDTH_PX / WIDTH_IN)
        pixels = np.frombuffer(raw.getvalue(), np.uint8).reshape(-1, WIDTH_PX, 4)
        return pixels[..., :3].copy()

    def _add_titles(self, times: float) -> tuple[Text, Text]:
        left, height_in = LEFT_IN / WIDTH_IN / 2, self._height_in
        speed = "" if times < 1.05 else f"   ({times:.1f} times as fast)"
        title = f"{self._scenario.title}{speed}"
        figure = self._figure
        size = min(11.0, 11.0 * MOST_LETTERS / max(len(title), 1))
        figure.text(left, 1 - 0.26 / height_in, title, color=INK, fontsize=size, fontweight="bold")
        line = 1 - 0.50 / height_in
        time = figure.text(left, line, "", color=INK, fontsize=9, fontweight="bold")
        return time, figure.text(left + 0.10, line, "", color=INK, fontsize=9)

    def _add_legend(self) -> None:
        lines: dict[str, dict[str, Any]] = {
            "parcel": {"color": FAINT, "lw": 3.2},
            "as its cells believe": {"color": INK, "lw": 1.2, "linestyle": DASHED},
            "goal": {"color": FAINT, "lw": 1.2, "linestyle": DOTTED},
        }
        marks = [Line2D([], [], label=name, **style) for name, style in lines.items()]
        # Filled column by column: cells in the upper row, lines in the lower one.
        handles: list[Artist] = [
            each for pair in zip(held_legend(), marks, strict=True) for each in pair
        ]
        self._figure.legend(
            handles=handles,
            loc="lower center",
            bbox_to_anchor=(0.5, 0.0),
            ncols=len(marks),
            frameon=False,
            fontsize=8.5,
            labelcolor=INK,
        )


class _MovingParcel:
    """A parcel's true outline and the one that its cells believe."""

    def __init__(self, axes: Axes, scenario: Scenario, record: Record, number: int) -> None:
        parcel, colour = scenario.parcel[number], parcel_colour(number)
        self._parcel = parcel
        self._true = record.pose[:, number]
        self._believed = shared_belief(record, number)
        self._error = belief_error(record, number, parcel)
        if goal := goal_of(scenario, parcel):
            ghost = _outline(axes, edgecolor=colour, linewidth=1.2, linestyle=DOTTED, zorder=5)
            ghost.set_xy(outline_m(np.array([goal.x_m, goal.y_m, goal.yaw_rad]), parcel))
            axes.plot(goal.x_m, goal.y_m, "+", color=dark(colour), markersize=9, zorder=5)
        self._solid = _outline(axes, edgecolor=colour, linewidth=3.2, zorder=6)
        self._dashed = _outline(axes, edgecolor=INK, linewidth=1.2, linestyle=DASHED, zorder=7)
        self._nose = _outline(axes, facecolor=dark(colour), zorder=6)

    def show(self, instant: int) -> None:
        """Move to where the parcel is, and is believed, at a sample of the record."""
        pose, believed = self._true[instant], self._believed[instant]
        self._solid.set_xy(outline_m(pose, self._parcel))
        self._nose.set_xy(nose_m(pose, self._parcel))
        known = bool(np.isfinite(believed).all())
        self._dashed.set_visible(known)
        if known:
            self._dashed.set_xy(outline_m(believed, self._parcel))

    def story(self, instant: int) -> str:
        """How far the cells' belief is off, in one clause."""
        away_m, turn_rad = self._error[instant].tolist()
        if not np.isfinite(away_m):
            return f"{self._parcel.name}: no cell has it"
        turn = "" if np.isnan(turn_rad) else f", {degrees(turn_rad):.1f}°"
        return f"{self._parcel.name}: believed {1000 * away_m:.1f} mm{turn} off"


def _outline(axes: Axes, **style: Any) -> Polygon:
    """A shape that gets its corners later."""
    shape = Polygon(np.zeros((3, 2)), **{"facecolor": "none", "edgecolor": "none", **style})
    axes.add_patch(shape)
    return shape
