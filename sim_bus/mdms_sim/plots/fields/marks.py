"""Marks that maps of fields share: equilibria by kind, where nothing pushes, and the legend."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_sim.physics.analysis.equilibria import Kind
from mdms_sim.physics.analysis.field_map import FieldMap
from mdms_sim.plots.canvas import FAINT

PULL, PARCEL = "#0b4a82", "#d55e00"
STABLE, UNSTABLE = "#009e73", "#c1272d"
MARKS = {
    Kind.STABLE: ("o", STABLE, STABLE, "stable"),
    Kind.SPIRAL: ("o", "white", STABLE, "stable with damping only (curl)"),
    Kind.NEUTRAL: (".", FAINT, FAINT, "free along a line, or going round"),
    Kind.SADDLE: ("X", "white", UNSTABLE, "saddle"),
    Kind.UNSTABLE: ("o", "white", UNSTABLE, "unstable"),
}
TIPS = "#e9ebed"
NO_FORCE = 1e-9
_LEAST_PT, _MOST_PT = 3.5, 11.0
#: Of what two marks are apart, either takes so much.
_SIDE = 0.85


def in_lanes(places: Floats, apart: float) -> NDArray[np.int64]:
    """A lane for each of rising places, from 0 on, so that all in one lane are so far apart."""
    ends: list[float] = []
    lanes = []
    for place in places.tolist():
        lane = next((n for n, end in enumerate(ends) if place - end >= apart), len(ends))
        ends[lane : lane + 1] = [place]
        lanes.append(lane)
    return np.array(lanes, dtype=np.int64)


def marker_size(others: Floats, place: tuple[float, float], points_per_m: float) -> float:
    """The size of a mark [points] that leaves the nearest of the others (N, 2) in sight."""
    apart_m = np.hypot(*(others - place).T)
    nearest_m = float(np.min(apart_m, initial=np.inf, where=apart_m > 0.0))
    return min(max(_SIDE * nearest_m * points_per_m, _LEAST_PT), _MOST_PT)


def free_of_push(pushes: Floats) -> NDArray[np.bool_]:
    """Where there is no push at all, here and beside."""
    none = abs(pushes) <= NO_FORCE * max(np.nanmax(abs(pushes)), 1e-12)
    beside = np.pad(none, 1)
    found: NDArray[np.bool_] = none & (beside[:-2] | beside[2:])
    return found


def shade(axes: Axes, along: Floats, free: NDArray[np.bool_]) -> None:
    """A band where the parcel rests anywhere."""
    axes.fill_between(
        along, 0, 1, where=free.tolist(), transform=axes.get_xaxis_transform(), color=f"{STABLE}22"
    )


def add_legend(figure: Figure, field: FieldMap) -> None:
    """What the marks mean, below a map."""
    handles: list[Artist] = [
        Line2D([], [], ls="", marker=marker, mfc=face, mec=edge, mew=1.8, ms=9, label=name)
        for kind, (marker, face, edge, name) in MARKS.items()
        if kind in {Kind.STABLE, Kind.UNSTABLE} or any(rest.kind is kind for rest in field.places)
    ]
    handles.append(Line2D([], [], color="#3d464e", marker=">", ms=5, label="reference of a wheel"))
    if len(field.y_m) > 1:
        handles.append(Line2D([], [], color=PULL, marker=">", ms=5, label="net force"))
        handles.append(Patch(fc=TIPS, label="tips"))
        handles.append(Patch(fc="none", ec=PARCEL, lw=2, label="parcel, settled"))
    pushes = field.turning_nm if len(field.y_m) > 1 else field.force_n[0, :, 0]
    if free_of_push(pushes).any():
        handles.append(Patch(fc=f"{STABLE}22", label="no push: rests anywhere"))
    figure.legend(
        handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=9
    )
