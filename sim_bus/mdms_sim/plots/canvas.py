"""What all pictures share: size, colours, type, and how they are written."""

import warnings
from collections.abc import Iterable
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

#: Written into every picture.
MARK = "drawn by mdms"
#: What a picture may be written as, and the metadata of each, which leave the date out.
FORMATS: dict[str, dict[str, str | None]] = {
    "png": {"Software": MARK},
    "svg": {"Creator": MARK, "Date": None},
    "pdf": {"Creator": MARK, "CreationDate": None},
}
DPI = 150
INK = "#1c2733"
FAINT = "#8b97a3"


class PictureFormatError(ValueError):
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
