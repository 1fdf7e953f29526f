"""The torque on a parcel over its yaws, and below it where it would rest."""

from math import degrees

import numpy as np
from matplotlib.axes import Axes

from mdms_model.scenario.scenario import Parcel
from mdms_sim.physics.analysis.field_map import FieldMap
from mdms_sim.plots.canvas import FAINT, INK, tidy
from mdms_sim.plots.fields.marks import PARCEL, STABLE, UNSTABLE, free_of_push, in_lanes, shade

#: Marks in one lane are so far apart, and lanes so high, in widths of a mark.
_APART, _MARK_PT, _LANE_PT = 1.25, 7.0, 9.0


def draw_turning(axes: Axes, parcel: Parcel, field: FieldMap) -> None:
    """The torque, and a line for each equilibrium down to its mark."""
    axes.axhline(0.0, color=FAINT, lw=0.9)
    yaw_deg, free = np.degrees(field.yaw_rad), free_of_push(field.turning_nm)
    shade(axes, yaw_deg, free)
    for rest in field.turns:
        colour = STABLE if rest.stable else UNSTABLE
        axes.axvline(degrees(rest.yaw_rad), color=colour, lw=0.7, alpha=0.5)
    axes.plot(yaw_deg, field.turning_nm, color=PARCEL, lw=1.6)
    axes.axvline(degrees(parcel.yaw_rad), color=PARCEL, lw=0.9, ls=(0, (2, 2)))
    axes.set_xlim(yaw_deg[0], yaw_deg[-1])
    axes.set_xticks(np.linspace(*axes.get_xlim(), 9))
    axes.set_ylabel("torque [N m], settled at each yaw", color=INK)
    axes.tick_params(labelbottom=False)
    tidy(axes)


def draw_rests(axes: Axes, field: FieldMap, width_pt: float) -> None:
    """Each equilibrium as a mark that no other hides, in axes of this width [points]."""
    turn_deg = float(np.degrees(field.yaw_rad[-1] - field.yaw_rad[0]))
    rests = sorted(field.turns, key=lambda rest: rest.yaw_rad)
    places = np.degrees([rest.yaw_rad for rest in rests])
    lanes = in_lanes(places, _APART * _MARK_PT / width_pt * turn_deg)
    for rest, place, lane in zip(rests, places.tolist(), lanes.tolist(), strict=True):
        face, edge = (STABLE, STABLE) if rest.stable else ("white", UNSTABLE)
        axes.plot(place, -lane, "o", mfc=face, mec=edge, mew=1.5, ms=_MARK_PT, clip_on=False)
    axes.set_ylim(-max(int(lanes.max(initial=0)), 1) - 0.6, 0.6)
    axes.set_yticks([])
    axes.set_xlabel("yaw [°]", color=INK)
    tidy(axes)
    axes.spines["left"].set_visible(False)


def rests_height_pt(field: FieldMap, width_pt: float) -> float:
    """How high the marks' strip is to be in axes of this width [points]."""
    turn_deg = float(np.degrees(field.yaw_rad[-1] - field.yaw_rad[0]))
    places = np.sort(np.degrees([rest.yaw_rad for rest in field.turns]))
    lanes = in_lanes(places, _APART * _MARK_PT / width_pt * turn_deg)
    return _LANE_PT * (2 + int(lanes.max(initial=0)))
