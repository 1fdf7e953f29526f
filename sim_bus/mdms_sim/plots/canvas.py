"""The common ground of all pictures: size, colours, type, scales, and how they are written.

A few samples do not set a scale. Time axes end when nothing moves any more.
"""

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator

from mdms_model.arrays import Floats
from mdms_model.errors import InputError
from mdms_model.run.record import Record

#: Written into every picture.
MARK = "drawn by mdms"
#: The formats of a picture, and the metadata of each, which leave the date out.
FORMATS: dict[str, dict[str, str | None]] = {
    "png": {"Software": MARK},
    "svg": {"Creator": MARK, "Date": None},
    "pdf": {"Creator": MARK, "CreationDate": None},
}
DPI = 150
INK = "#1c2733"
FAINT = "#8b97a3"


class PictureFormatError(InputError):
    """A name that says no format in which pictures are written."""


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure of its own; no state is shared with any other."""
    figure = Figure(figsize=(width_in, height_in), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes) -> None:
    """Take away the frame's unneeded sides and quieten its colours."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
    axes.tick_params(colors=INK, labelsize=9)


def draw_as_map(axes: Axes) -> None:
    """One metre is as long along x as along y, and no frame stands round the table."""
    axes.set_aspect("equal", anchor="N")
    axes.tick_params(colors=INK, labelsize=9, length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def form_of(path: Path, forms: Iterable[str] = tuple(FORMATS)) -> str:
    """The form that a name's ending says, of these; PNG without an ending.

    Raises PictureFormatError for any other.
    """
    form = path.suffix.removeprefix(".").lower() or "png"
    if form not in forms:
        *others, last = (f".{name}" for name in forms)
        raise PictureFormatError(
            f"{path.suffix}: nothing is drawn in that form; the name is to end in "
            f"{', '.join(others)} or {last}"
        )
    return form


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the name: the same bytes for the same picture.

    Raises OSError, and PictureFormatError; see `form_of`. `MARK` stands in the file.

    Titles and names are people's own text: no dollar sign in them starts a formula, and a letter
    that the font lacks is drawn as a box without a word about it.
    """
    form = form_of(path)
    for text in figure.findobj(Text):
        text.set_parse_math(False)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        with matplotlib.rc_context({"svg.hashsalt": MARK}):
            figure.savefig(path, format=form, metadata=FORMATS[form])


#: Nearly all samples are within these percentiles.
_USUAL = (1.0, 99.0)
#: Values that lie farther out than so many spans of nearly all are left outside.
_FAR = 1.0
_MARGIN = 0.06
#: A parcel that differs by less from where it ends has not moved [m, m, rad].
_STILL = np.array([5e-4, 5e-4, np.radians(0.1)])
#: Of what is shown, so much at rest is shown still, and so much at least [s]; less than this share
#: is not cut off.
_REST_SHARE, _REST_S, _WORTH = 0.12, 0.3, 0.15


def usual_limits(values: Floats, least: float = 0.0) -> tuple[float, float]:
    """Bounds of all values, or of nearly all where a few are far out; `least` apart."""
    known = values[np.isfinite(values)]
    if not len(known):
        return -least / 2, least / 2
    low, high = np.percentile(known, _USUAL).tolist()
    reach = _FAR * max(high - low, least / 2)
    low = max(float(known.min()), low - reach)
    high = min(float(known.max()), high + reach)
    missing = max(0.0, least - (high - low)) / 2
    return low - missing, high + missing


def usual_most(values: Floats, least: float = 0.0) -> float:
    """The greatest size, but for a few far out; 1 where all is nought or unknown.

    A value of nought, or below `least`, is not counted among the others.
    """
    sizes = abs(values[np.isfinite(values)])
    return max(usual_limits(sizes[sizes > least])[1], least) or 1.0


def share_outside(values: Floats, most: float) -> float:
    """Which share of the known values is larger in size."""
    known = np.isfinite(values)
    return float((abs(values[known]) > most * (1 + 1e-9)).sum()) / max(int(known.sum()), 1)


def mark_outside(axes: Axes, time_s: Floats, lines: Sequence[tuple[Floats, str]]) -> None:
    """A triangle above the axes wherever a line begins to lie beyond them, and the greatest value.

    Lines are values (T,) and their colours.
    """
    top = axes.get_ylim()[1]
    greatest, at_s, paint = top, 0.0, INK
    for values, colour in lines:
        outside = np.nan_to_num(values, nan=top) > top
        starts = np.flatnonzero(np.diff(outside, prepend=False) & outside)
        if not len(starts):
            continue
        tops = np.full(len(starts), top)
        axes.plot(time_s[starts], tops, "^", color=colour, ms=5, clip_on=False, zorder=9)
        peak = int(np.nanargmax(values))
        if values[peak] > greatest:
            greatest, at_s, paint = float(values[peak]), float(time_s[peak]), colour
    if greatest > top:
        axes.annotate(
            f"{greatest:.3g}",
            (at_s, top),
            xytext=(0, 5),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            color=paint,
            annotation_clip=False,
        )


def fit_values(axes: Axes, values: Floats, least: float) -> None:
    """Limits and ticks of a panel of these values."""
    low, high = usual_limits(values, least)
    margin = _MARGIN * (high - low)
    axes.set_ylim(low - margin, high + margin)
    axes.yaxis.set_major_locator(MaxNLocator(4))


def shown_until_s(record: Record) -> float:
    """When all parcels have come to rest for good, and a little more [s]."""
    poses, time_s = record.pose, record.time_s
    away = (abs(poses - poses[-1]) > _STILL) | (np.isfinite(poses) != np.isfinite(poses[-1]))
    moving = np.flatnonzero(away.any(axis=(1, 2)))
    end_s = float(time_s[-1])
    if not len(moving):
        return end_s
    rest_s = float(time_s[min(moving[-1] + 1, len(time_s) - 1)]) - float(time_s[0])
    until_s = float(time_s[0]) + rest_s * (1 + _REST_SHARE) + _REST_S
    return until_s if until_s < end_s - _WORTH * (end_s - float(time_s[0])) else end_s


def limit_time(axes: Axes, record: Record) -> None:
    """Have the axis end where all parcels rest; a run of one instant has some room after it."""
    start_s, until_s = float(record.time_s[0]), shown_until_s(record)
    axes.set_xlim(start_s, until_s if until_s > start_s else start_s + _REST_S)


def label_time(axes: Axes, record: Record) -> None:
    """Name the axis of time, and the part that it leaves out."""
    until_s, end_s = shown_until_s(record), float(record.time_s[-1])
    rest = "" if until_s >= end_s else f"; at rest until {end_s:g} s"
    axes.set_xlabel(f"time [s]{rest}", color=INK, fontsize=9)
