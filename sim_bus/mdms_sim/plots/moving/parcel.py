"""A parcel in an animation: where it is, where it is believed, its name, its goal and its way."""

from math import degrees
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from mdms_model.arrays import Floats
from mdms_model.outline import outline_m
from mdms_model.run.colours import colours_of
from mdms_model.run.planned import goals_at
from mdms_model.run.record import Plan, Record
from mdms_model.run.shared_belief import belief_error, host_error, shared_belief
from mdms_model.scenario.scenario import Scenario
from mdms_sim.plots.canvas import INK
from mdms_sim.plots.held_cells import dark
from mdms_sim.plots.top_view import DASHED
from mdms_sim.plots.ways import nose_m, write_name

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
