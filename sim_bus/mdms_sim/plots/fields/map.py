"""A field at one glance: the force on a parcel over its places, and the torque over its yaws."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from mdms_model.array import build_wheels, cell_centres
from mdms_model.arrays import Floats
from mdms_model.outline import outline_m
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_sim.physics.analysis.equilibria import Kind
from mdms_sim.physics.analysis.field_map import FieldMap
from mdms_sim.physics.analysis.held_parcel import Law
from mdms_sim.plots.canvas import FAINT, INK, draw_as_map, new_figure
from mdms_sim.plots.fields.marks import MARKS, PARCEL, PULL, TIPS, add_legend, marker_size
from mdms_sim.plots.fields.row import draw_row
from mdms_sim.plots.fields.turning import draw_rests, draw_turning, rests_height_pt
from mdms_sim.plots.scales import share_outside, usual_most

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
    title = f"{scenario.title}: what the field does to {parcel.name}"
    figure.text(0.06, 1 - 0.42 / height_in, title, color=INK, fontsize=14, fontweight="bold")
    figure.text(0.06, 1 - 0.70 / height_in, _story(scenario, field), color=FAINT, fontsize=10)
    return figure


def _story(scenario: Scenario, field: FieldMap) -> str:
    alone = [rest.kind for rest in field.places if rest.alone]
    counts = {kind: alone.count(kind) for kind in Kind}
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
