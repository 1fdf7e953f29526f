"""A field at one glance: the force on a parcel over places, and the torque over its yaws."""

from math import degrees

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from numpy.typing import NDArray

from mdms_model.array import build_wheels, cell_centres
from mdms_model.arrays import Floats
from mdms_model.outline import outline_m
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_sim.physics.field_map import FieldMap, Law, Stability
from mdms_sim.plots.canvas import (
    FAINT,
    INK,
    draw_as_map,
    new_figure,
    share_outside,
    tidy,
    usual_most,
)

PULL, PARCEL = "#0b4a82", "#d55e00"
STABLE, UNSTABLE = "#009e73", "#c1272d"
MARKS = {
    Stability.STABLE: ("o", STABLE, STABLE, "stable"),
    Stability.SPIRAL: ("o", "white", STABLE, "stable with damping only (curl)"),
    Stability.NEUTRAL: (".", FAINT, FAINT, "free along a line, or going round"),
    Stability.SADDLE: ("X", "white", UNSTABLE, "saddle"),
    Stability.UNSTABLE: ("o", "white", UNSTABLE, "unstable"),
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
    none = abs(pushes) <= NO_FORCE * np.nanmax(abs(pushes), initial=1e-12)
    beside = np.pad(none, 1)
    found: NDArray[np.bool_] = none & (beside[:-2] | beside[2:])
    return found


def shade(axes: Axes, along: Floats, free: NDArray[np.bool_]) -> None:
    """A band where the parcel rests anywhere."""
    axes.fill_between(
        along, 0, 1, where=free.tolist(), transform=axes.get_xaxis_transform(), color=f"{STABLE}22"
    )


def add_legend(figure: Figure, field: FieldMap) -> None:
    """The meaning of the marks, below a map."""
    handles: list[Artist] = [
        Line2D([], [], ls="", marker=marker, mfc=face, mec=edge, mew=1.8, ms=9, label=name)
        for kind, (marker, face, edge, name) in MARKS.items()
        if kind in {Stability.STABLE, Stability.UNSTABLE}
        or any(rest.kind is kind for rest in field.places)
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


#: How wide the axes are [points].
AXES_PT = 0.88 * 10.0 * 72


def draw_row(scenario: Scenario, parcel: Parcel, field: FieldMap, reference_m_s: Floats) -> Figure:
    """The figure, without its titles."""
    del parcel
    figure = new_figure(10.0, 5.4)
    axes = figure.add_axes((0.09, 0.20, 0.88, 0.62))
    force_n = field.force_n[0, :, 0]
    axes.axhline(0.0, color=FAINT, lw=0.9)
    axes.plot(field.x_m, force_n, color=PULL, lw=2.0)
    shade(axes, field.x_m, free_of_push(force_n))
    places_m = np.array([(rest.x_m, 0.0) for rest in field.places])
    points_per_m = AXES_PT / (field.x_m[-1] - field.x_m[0])
    for rest in field.places:
        marker, face, edge, _ = MARKS[rest.kind]
        size = marker_size(places_m, (rest.x_m, 0.0), points_per_m)
        axes.plot(rest.x_m, 0.0, marker, mfc=face, mec=edge, mew=size / 6, ms=size, zorder=8)
    _draw_row_wheels(axes, scenario, reference_m_s)
    axes.set_xlim(field.x_m[0], field.x_m[-1])
    axes.set_xlabel("x of the parcel's centre [m]", color=INK)
    axes.set_ylabel("net force [N]", color=INK)
    tidy(axes)
    add_legend(figure, field)
    return figure


def _draw_row_wheels(axes: Axes, scenario: Scenario, reference_m_s: Floats) -> None:
    """Each wheel at its place, with its reference."""
    share = reference_m_s / (abs(reference_m_s).max() or 1.0)
    places_m = build_wheels(scenario).position_m[:, 0]
    place = axes.get_xaxis_transform()
    for x_m, part in zip(places_m, share, strict=True):
        axes.plot(x_m, 0.03, "o", color="#7d8790", ms=6, transform=place)
        if part:
            tip = (x_m + 0.35 * scenario.array.pitch_m * part, 0.03)
            axes.annotate(
                "",
                tip,
                (x_m, 0.03),
                xycoords=place,
                arrowprops={"arrowstyle": "-|>", "color": "#3d464e", "lw": 1.4},
            )


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


POINTS_PER_IN = 72.0
FORCES = LinearSegmentedColormap.from_list("forces", ["#ffffff", "#dbe7f3", "#9fbfdd", "#5a8fc0"])
ARROWS = 26
LAWS = {Law.SLIDING: "all wheels slide", Law.AT_REST: "motors against a parcel at rest"}


def draw_field_map(
    scenario: Scenario, parcel: Parcel, field: FieldMap, reference_m_s: Floats
) -> Figure:
    """The figure of one parcel's map; `reference_m_s` (W,) shows on the wheels."""
    draw = draw_row if len(field.y_m) == 1 else _draw_plane
    figure = draw(scenario, parcel, field, reference_m_s)
    height_in = figure.get_figheight()
    title = f"{scenario.title}: effect of the field on {parcel.name}"
    figure.text(0.06, 1 - 0.42 / height_in, title, color=INK, fontsize=14, fontweight="bold")
    figure.text(0.06, 1 - 0.70 / height_in, _story(scenario, field), color=FAINT, fontsize=10)
    return figure


def _story(scenario: Scenario, field: FieldMap) -> str:
    alone = [rest.kind for rest in field.places if rest.alone]
    counts = {kind: alone.count(kind) for kind in Stability}
    parts = [f"{count} {kind.value}" for kind, count in counts.items() if count]
    if len(alone) < len(field.places):
        parts.append("lines of them")
    found = ", ".join(parts) or "none by itself"
    return f"{scenario.motion.field} field, {LAWS[field.law]};  equilibria: {found}"


def _draw_plane(
    scenario: Scenario, parcel: Parcel, field: FieldMap, reference_m_s: Floats
) -> Figure:
    width_in, left, middle, beside, right = 13.0, 0.06, 0.60, 0.71, 0.985
    share = (field.y_m[-1] - field.y_m[0]) / (field.x_m[-1] - field.x_m[0])
    deep_in = (middle - left) * width_in * share
    view_in = min(max(deep_in, 3.6), 8.0)
    height_in = view_in + 1.9
    figure = new_figure(width_in, height_in)
    bottom, height = 0.95 / height_in, view_in / height_in
    axes = figure.add_axes((left, bottom, middle - left, height))
    # The map hangs from the top of its box.
    deep = min(deep_in, view_in) / height_in
    _draw_forces(figure, axes, (middle + 0.012, bottom + height - deep, 0.009, deep), field)
    _draw_array(axes, scenario, reference_m_s)
    _draw_parcel(axes, parcel, field)
    _mark_places(axes, field, min(deep_in, view_in) / share)
    wide_pt = (right - beside) * width_in * POINTS_PER_IN
    strip = rests_height_pt(field, wide_pt) / POINTS_PER_IN / height_in
    turning = figure.add_axes((beside, bottom + strip, right - beside, height - strip))
    draw_turning(turning, parcel, field)
    # Equilibria have a strip of their own, so that none hides another, or the curve.
    rests = figure.add_axes((beside, bottom, right - beside, strip), sharex=turning)
    draw_rests(rests, field, wide_pt)
    add_legend(figure, field)
    return figure


def _draw_forces(
    figure: Figure, axes: Axes, scale_box: tuple[float, float, float, float], field: FieldMap
) -> None:
    size_n = np.hypot(field.force_n[..., 0], field.force_n[..., 1])
    most_n = usual_most(size_n)
    mesh = axes.pcolormesh(
        field.x_m, field.y_m, size_n, cmap=FORCES, vmin=0.0, vmax=most_n, shading="nearest"
    )
    scale = figure.add_axes(scale_box)
    figure.colorbar(mesh, cax=scale, extend="max" if share_outside(size_n, most_n) else "neither")
    scale.set_title("[N]", fontsize=9, color=INK)
    scale.tick_params(labelsize=8, colors=INK)
    step = max(1, round(len(field.x_m) / ARROWS))
    rows, columns = _thin(len(field.y_m), step), _thin(len(field.x_m), step)
    shown = field.force_n[np.ix_(rows, columns)]
    lengths = np.hypot(shown[..., 0], shown[..., 1])[..., None]
    headings = shown / np.where(lengths > 0.0, lengths, 1.0)
    arrows = headings * np.sqrt(lengths.clip(max=most_n) / most_n)
    spacing_m = step * (field.x_m[1] - field.x_m[0])
    axes.quiver(
        field.x_m[columns],
        field.y_m[rows],
        arrows[..., 0],
        arrows[..., 1],
        color=PULL,
        angles="xy",
        scale_units="xy",
        scale=1.15 / spacing_m,
        width=0.0022,
        pivot="middle",
        zorder=3,
    )
    axes.set_xlim(field.x_m[0], field.x_m[-1])
    axes.set_ylim(field.y_m[0], field.y_m[-1])
    axes.set_facecolor(TIPS)
    axes.set_xlabel("x of the parcel's centre [m]", color=INK)
    axes.set_ylabel("y of the parcel's centre [m]", color=INK)
    draw_as_map(axes)


def _thin(count: int, step: int) -> list[int]:
    """Every so many points, the same on both sides of the middle."""
    middle = count // 2
    return sorted({*range(middle, count, step), *range(middle, -1, -step)})


def _draw_array(axes: Axes, scenario: Scenario, reference_m_s: Floats) -> None:
    """Cells, and each wheel as an arrow along which it pushes."""
    pitch_m = scenario.array.pitch_m
    for x_m, y_m in cell_centres(scenario.array):
        corner = (x_m - 0.47 * pitch_m, y_m - 0.47 * pitch_m)
        axes.add_patch(
            Rectangle(corner, 0.94 * pitch_m, 0.94 * pitch_m, fc="none", ec="#c9d1d8", lw=0.8)
        )
    wheels = build_wheels(scenario)
    share = reference_m_s / (abs(reference_m_s).max() or 1.0)
    pushes = wheels.direction * (share * 0.3 * pitch_m)[:, None]
    bars = wheels.direction * 0.1 * pitch_m
    ends = np.stack((wheels.position_m - bars, wheels.position_m + bars), axis=1)
    axes.add_collection(LineCollection(list(ends), colors="#7d8790", linewidths=3.0, zorder=4))
    axes.quiver(
        *wheels.position_m.T,
        *pushes.T,
        color="#3d464e",
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.0032,
        zorder=5,
    )


def _draw_parcel(axes: Axes, parcel: Parcel, field: FieldMap) -> None:
    """The parcel as it lies at its own yaw, where it settles."""
    own = int(np.argmin(abs(field.yaw_rad - parcel.yaw_rad)))
    pose = np.array([*field.settled_m[own], parcel.yaw_rad])
    corners = outline_m(pose, parcel)
    axes.add_patch(Polygon(corners, fc="none", ec=PARCEL, lw=2.2, zorder=6))


def _mark_places(axes: Axes, field: FieldMap, width_in: float) -> None:
    """Equilibria, those that are near to each other smaller, in a map of this width."""
    alone_m = np.array([(rest.x_m, rest.y_m) for rest in field.places if rest.alone])
    points_per_m = width_in * POINTS_PER_IN / (field.x_m[-1] - field.x_m[0])
    for rest in field.places:
        marker, face, edge, _ = MARKS[rest.kind]
        size = marker_size(alone_m, (rest.x_m, rest.y_m), points_per_m) if rest.alone else 5.0
        axes.plot(
            rest.x_m, rest.y_m, marker, mfc=face, mec=edge, mew=size / 6, markersize=size, zorder=8
        )
