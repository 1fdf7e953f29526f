"""One frame of an animation: the table from above, true, believed and planned."""

from io import BytesIO
from math import degrees
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.text import Text
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.outline import outline_m
from mdms_model.run.colours import colours_of
from mdms_model.run.derived import belief_error, goals_at, host_error, plan_at, shared_belief
from mdms_model.run.record import Plan, Record
from mdms_model.scenario.scenario import Scenario
from mdms_sim.plots.canvas import FAINT, INK, draw_as_map, new_figure
from mdms_sim.plots.top_view import (
    DASHED,
    HeldCells,
    add_wheels,
    dark,
    draw_exits,
    extent_m,
    held_legend,
    nose_m,
    write_name,
)

GOAL = (0, (1, 1.2))
#: With more parcels, each is named.
ONE = 1


class MovingParcel:
    """Shapes in axes, moved to each instant of a record."""

    def __init__(self, axes: Axes, scenario: Scenario, record: Record, number: int) -> None:
        parcel, colour = scenario.parcel[number], colours_of(scenario)[number]
        self._scenario, self._record, self._parcel = scenario, record, parcel
        self._true = record.pose[:, number]
        if record.identity is not None:
            self._believed = shared_belief(record, number)
            self._error = belief_error(record, number, parcel)
        else:
            nowhere = np.full_like(self._true, np.nan)
            self._believed = nowhere if record.estimate is None else record.estimate[:, number]
            self._error = host_error(scenario, record, number)
        self.goal = _outline(axes, edgecolor=colour, linewidth=1.2, linestyle=GOAL, zorder=5)
        (self._cross,) = axes.plot([], [], "+", color=dark(colour), markersize=9, zorder=5)
        (self.way,) = axes.plot([], [], color=colour, lw=1.6, alpha=0.8, zorder=5)
        self._fill = _outline(axes, facecolor=f"{colour}30", zorder=3)
        self._solid = _outline(axes, edgecolor=colour, linewidth=3.0, zorder=6)
        self._dashed = _outline(axes, edgecolor=INK, linewidth=1.2, linestyle=DASHED, zorder=7)
        self._nose = _outline(axes, facecolor=dark(colour), zorder=6)
        self.name = write_name(axes, parcel.name, (0.0, 0.0), dark(colour))
        self._named = len(scenario.parcel) > ONE
        self._last_goal: Floats | None = None

    @property
    def has_goal(self) -> bool:
        """Whether it has one at any time."""
        return self._parcel.goal is not None or any(
            self._parcel.name in plan.goals for plan in self._record.plans
        )

    def is_there(self, instant: int) -> bool:
        """Whether it is on the table."""
        return bool(np.isfinite(self._true[instant]).all())

    def show(self, instant: int, plan: Plan | None) -> None:
        """Move to where the parcel is, and is believed, at a sample of the record."""
        pose, believed = self._true[instant], self._believed[instant]
        there, known = self.is_there(instant), bool(np.isfinite(believed).all())
        for shape in (self._fill, self._solid, self._nose):
            shape.set_visible(there)
        self.name.set_visible(there and self._named)
        if there:
            self._solid.set_xy(outline_m(pose, self._parcel))
            self._fill.set_xy(outline_m(pose, self._parcel))
            self._nose.set_xy(nose_m(pose, self._parcel))
            self.name.xy = (float(pose[0]), float(pose[1]))
        self._dashed.set_visible(known)
        if known:
            self._dashed.set_xy(outline_m(believed, self._parcel))
        way = None if plan is None else plan.ways.get(self._parcel.name)
        self.way.set_data(*((), ()) if way is None else self._left(way, believed))
        self._show_goal(instant)

    def _left(self, way: Floats, pose: Floats) -> Floats:
        """The part of a way that is still ahead, x and y: from its place nearest to the parcel."""
        if not np.isfinite(pose).all():
            return way[:, :2].T
        points = _fine(way[:, :2])
        nearest = int(np.argmin(np.hypot(*(points - pose[:2]).T)))
        ahead: Floats = points[nearest:].T
        return ahead

    def _show_goal(self, instant: int) -> None:
        goals = goals_at(self._scenario, self._record, float(self._record.time_s[instant]))
        goal = goals.get(self._parcel.name)
        self.goal.set_visible(goal is not None)
        self._cross.set_visible(goal is not None)
        if goal is not None and goal is not self._last_goal:
            self._last_goal = goal
            self.goal.set_xy(outline_m(np.nan_to_num(goal), self._parcel))
            self._cross.set_data([goal[0]], [goal[1]])

    def story(self, instant: int) -> str:
        """How far the belief is off, in one clause; nothing where there is none to be off."""
        if not np.isfinite(self._error[:, 0]).any():
            return ""
        away_m, turn_rad = self._error[instant].tolist()
        if not np.isfinite(away_m):
            nobody = "no cell has it" if self._record.identity is not None else "not found"
            return f"{self._parcel.name}: {nobody}"
        turn = "" if np.isnan(turn_rad) else f", {degrees(turn_rad):.1f}°"
        return f"{self._parcel.name}: believed {1000 * away_m:.1f} mm{turn} off"


def _fine(points: Floats) -> Floats:
    """Points along straight lines, a centimetre apart and less."""
    steps_m = np.hypot(*np.diff(points, axis=0).T)
    along_m = np.concatenate(([0.0], np.cumsum(steps_m)))
    wanted_m = np.linspace(0.0, along_m[-1], int(along_m[-1] / 0.01) + 2)
    columns = [np.interp(wanted_m, along_m, column) for column in points.T]
    return np.stack(columns, axis=1)


def _outline(axes: Axes, **style: Any) -> Polygon:
    """A shape that gets its corners later."""
    shape = Polygon(np.zeros((3, 2)), **{"facecolor": "none", "edgecolor": "none", **style})
    axes.add_patch(shape)
    return shape


WIDTH_IN, WIDTH_PX = 6.4, 640
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN = 0.55, 0.22, 0.62, 0.92
#: How many parcels the caption has room for.
MOST_TOLD = 2
#: A longer title is smaller.
MOST_LETTERS = 56
#: A wheel whose surface is faster turns [m/s].
TURNS_M_S = 0.004
TURNING, STILL = "#39434d", "#c3cad0"
#: How much of a colour covers the cells, in hexadecimal digits.
RESERVED = "48"
SQUARE = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
#: Of columns of the legend.
MOST_COLUMNS = 4


class MovingView:
    """The figure of a run in the plane, drawn anew for each instant; `times` as fast."""

    def __init__(self, scenario: Scenario, record: Record, times: float = 1.0) -> None:
        self._scenario, self._record = scenario, record
        low_m, high_m = extent_m(scenario, record)
        width_in = WIDTH_IN - LEFT_IN - RIGHT_IN
        view_in = width_in * (high_m[1] - low_m[1]) / (high_m[0] - low_m[0])
        # A video has an even number of lines.
        height_px = 2 * round((TOP_IN + view_in + BOTTOM_IN) * WIDTH_PX / WIDTH_IN / 2)
        self._height_in = height_px * WIDTH_IN / WIDTH_PX
        self._figure = figure = new_figure(WIDTH_IN, self._height_in)
        bottom = BOTTOM_IN / self._height_in
        axes = figure.add_axes(
            (LEFT_IN / WIDTH_IN, bottom, width_in / WIDTH_IN, view_in / self._height_in)
        )
        self._cells = HeldCells(axes, scenario.array)
        self.tiles = PolyCollection([], zorder=2, linewidths=0, antialiaseds=False)
        axes.add_collection(self.tiles)
        draw_exits(axes, scenario)
        self._wheels = add_wheels(axes, scenario, 2.0)
        self.parcels = [
            MovingParcel(axes, scenario, record, number) for number in range(len(scenario.parcel))
        ]
        self._numbers = {parcel.name: n for n, parcel in enumerate(scenario.parcel)}
        self._colours = colours_of(scenario)
        self._plan: Plan | None = None
        _as_table(axes, low_m, high_m)
        self._time, self._caption = self._add_titles(times)
        self._add_legend()
        for text in figure.findobj(Text):
            text.set_parse_math(False)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of a frame, both even."""
        return WIDTH_PX, round(self._height_in * WIDTH_PX / WIDTH_IN)

    def pixels(self, instant: int) -> NDArray[np.uint8]:
        """The frame of a sample of the record, of shape (height, width, 3)."""
        record = self._record
        time_s = float(record.time_s[instant])
        if record.identity is not None and record.state is not None:
            self._cells.show(record.identity[instant], record.state[instant])
        turning = abs(np.nan_to_num(record.speed_m_s[instant])) > TURNS_M_S
        self._wheels.set_color([TURNING if turns else STILL for turns in turning])
        plan = plan_at(record, time_s)
        self._show_tiles(plan)
        for parcel in self.parcels:
            parcel.show(instant, plan)
        self._time.set_text(f"{time_s:.1f} s")
        self._caption.set_text(self._told(instant))
        raw = BytesIO()
        self._figure.savefig(raw, format="raw", dpi=WIDTH_PX / WIDTH_IN)
        pixels = np.frombuffer(raw.getvalue(), np.uint8).reshape(-1, WIDTH_PX, 4)
        return pixels[..., :3].copy()

    def _show_tiles(self, plan: Plan | None) -> None:
        """Tiles in the colour of the parcel that is next on them."""
        if plan is self._plan or plan is None:
            return
        self._plan = plan
        tiles = [tile for tile in plan.tiles if tile.parcels and tile.parcels[0] in self._numbers]
        middles_m = np.array([(tile.x_m, tile.y_m) for tile in tiles]).reshape(-1, 1, 2)
        halves_m = np.array([tile.side_m / 2 for tile in tiles]).reshape(-1, 1, 1)
        self.tiles.set_verts(middles_m + halves_m * SQUARE)
        paints = [to_rgba(f"{colour}{RESERVED}") for colour in self._colours]
        self.tiles.set_facecolor([paints[self._numbers[tile.parcels[0]]] for tile in tiles])

    def _told(self, instant: int) -> str:
        """The text below the title."""
        if self._scenario.stream:
            time_s = self._record.time_s[instant] + 1e-9
            left = sum(e.kind == "exit" and e.time_s <= time_s for e in self._record.events)
            there = sum(parcel.is_there(instant) for parcel in self.parcels)
            return f"{there} on the table" + f", {left} have left" * bool(left)
        told = [parcel.story(instant) for parcel in self.parcels[:MOST_TOLD]]
        if len(self.parcels) > MOST_TOLD:
            told.append(f"{len(self.parcels) - MOST_TOLD} more")
        return "     ".join(filter(None, told))

    def _add_titles(self, times: float) -> tuple[Text, Text]:
        left, height_in = LEFT_IN / WIDTH_IN / 2, self._height_in
        speed = "" if abs(times - 1) < 0.05 else f"   ({times:.2g} times as fast)"
        title = f"{self._scenario.title}{speed}"
        figure = self._figure
        size = min(11.0, 11.0 * MOST_LETTERS / max(len(title), 1))
        figure.text(left, 1 - 0.26 / height_in, title, color=INK, fontsize=size, fontweight="bold")
        line = 1 - 0.50 / height_in
        time = figure.text(left, line, "", color=INK, fontsize=9, fontweight="bold")
        return time, figure.text(left + 0.10, line, "", color=INK, fontsize=9)

    def _add_legend(self) -> None:
        record, has_layer = self._record, self._record.identity is not None
        lines: dict[str, dict[str, Any]] = {"parcel": {"color": FAINT, "lw": 3.2}}
        if has_layer or record.estimate is not None:
            whose = "its cells" if has_layer else "the host"
            lines[f"as {whose} believe{'' if has_layer else 's'}"] = {
                **{"color": INK, "lw": 1.2, "linestyle": DASHED}
            }
        if any(parcel.has_goal for parcel in self.parcels):
            lines["goal"] = {"color": FAINT, "lw": 1.2, "linestyle": GOAL}
        if any(plan.ways for plan in record.plans):
            lines["way"] = {"color": FAINT, "lw": 1.6}
        handles: list[Artist] = [
            Line2D([], [], label=name, **style) for name, style in lines.items()
        ]
        if has_layer:
            handles += held_legend()
        if any(plan.tiles for plan in record.plans):
            handles.append(Patch(facecolor=f"{FAINT}{RESERVED}", label="reserved"))
        self._figure.legend(
            handles=handles,
            loc="lower center",
            bbox_to_anchor=(0.5, 0.0),
            ncols=min(-(-len(handles) // 2), MOST_COLUMNS) if len(handles) > 4 else len(handles),
            frameon=False,
            fontsize=8.5,
            labelcolor=INK,
        )


def _as_table(axes: Axes, low_m: NDArray[np.float64], high_m: NDArray[np.float64]) -> None:
    axes.set_xlim(low_m[0], high_m[0])
    axes.set_ylim(low_m[1], high_m[1])
    axes.set_xlabel("x [m]", color=INK, fontsize=9, labelpad=1)
    axes.set_ylabel("y [m]", color=INK, fontsize=9, labelpad=1)
    draw_as_map(axes)
    axes.tick_params(labelsize=8)
