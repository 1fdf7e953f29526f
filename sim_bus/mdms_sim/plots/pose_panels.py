"""x, y and yaw of all parcels over time, with their goals and what the coordinator believed."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mdms_model.arrays import Floats
from mdms_model.run.colours import parcel_colour
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Scenario, goal_of
from mdms_sim.plots.canvas import INK, tidy

PANELS = (("x [m]", 1.0), ("y [m]", 1.0), ("yaw [°]", 180 / np.pi))
GAP_SHARE = 0.1
LEAST_SPAN = (0.02, 0.02, 4.0)


def draw_pose_panels(
    figure: Figure, box: tuple[float, float, float, float], scenario: Scenario, record: Record
) -> None:
    """Three panels, one above the other, in a box (left, bottom, width, height) of the figure."""
    left, bottom, width, height = box
    step = height / len(PANELS)
    for part, (name, factor) in enumerate(PANELS):
        low = bottom + height - (part + 1) * step
        axes = figure.add_axes((left, low, width, step * (1 - GAP_SHARE)))
        for number, parcel in enumerate(scenario.parcel):
            _draw_parcel(axes, record, number, part, factor)
            if goal := goal_of(scenario, parcel):
                wanted = (goal.x_m, goal.y_m, goal.yaw_rad)[part] * factor
                axes.axhline(wanted, color=parcel_colour(number), lw=1.1, linestyle=(0, (4, 2)))
        axes.set_ylabel(name, color=INK)
        axes.set_xlim(record.time_s[0], record.time_s[-1])
        _widen(axes, LEAST_SPAN[part])
        axes.yaxis.set_major_locator(MaxNLocator(5, prune="both"))
        tidy(axes)
        if part < len(PANELS) - 1:
            axes.tick_params(labelbottom=False)
    axes.set_xlabel("time [s]", color=INK)


def _draw_parcel(axes: Axes, record: Record, number: int, part: int, factor: float) -> None:
    axes.plot(
        record.time_s, record.pose[:, number, part] * factor, color=parcel_colour(number), lw=2.2
    )
    if record.estimate is not None:
        believed = _near(record.estimate[:, number, part], record.pose[:, number, part], part)
        axes.plot(record.time_s, believed * factor, color=INK, lw=0.9)


def _near(believed: Floats, true: Floats, part: int) -> Floats:
    """An angle told within the turn nearest to the true one; lengths as they are."""
    turns = np.round((true - believed) / (2 * np.pi)) if part == 2 else 0.0
    return believed + turns * 2 * np.pi


def _widen(axes: Axes, least: float) -> None:
    """Keep noise small: no panel shows less than a fair span."""
    low, high = axes.get_ylim()
    missing = max(0.0, least - (high - low)) / 2
    axes.set_ylim(low - missing, high + missing)
