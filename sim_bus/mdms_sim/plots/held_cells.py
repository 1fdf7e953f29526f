"""Cells as squares in the colour of the parcel that they report, by what they are to it."""

from colorsys import hls_to_rgb, rgb_to_hls

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import to_hex, to_rgb
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from mdms_model.array import cell_centres
from mdms_model.run.colours import parcel_colour
from mdms_model.scenario.scenario import Array
from mdms_protocol.neighbours import frames as wire
from mdms_sim.plots.canvas import FAINT

FREE, FREE_EDGE = "#f3f5f7", "#dde2e6"
#: Of the pitch: room for the outline of a promised cell beside that of its neighbour.
SIDE_SHARE = 0.92
#: How much of a parcel's colour the square of a cell has.
NEAR_SHARE, UNDER_SHARE = 0.16, 0.45
PROMISED_WIDTH, PLAIN_WIDTH = 2.0, 0.8
_DARK = 0.7


def tint(colour: str, share: float) -> str:
    """So much of a colour on white; nothing shines through it."""
    red, green, blue = (1 - share * (1 - part) for part in to_rgb(colour))
    return to_hex((red, green, blue))


def dark(colour: str) -> str:
    """The colour for lines that lie on squares of it."""
    hue, light, saturation = rgb_to_hls(*to_rgb(colour))
    return to_hex(hls_to_rgb(hue, _DARK * light, saturation))


class HeldCells:
    """The squares of all cells in axes: near a parcel pale, promised outlined, under it filled."""

    def __init__(self, axes: Axes, array: Array) -> None:
        side_m = SIDE_SHARE * array.pitch_m
        corners_m = cell_centres(array) - side_m / 2
        squares = [Rectangle((x_m, y_m), side_m, side_m) for x_m, y_m in corners_m]
        self.squares = PatchCollection(squares, facecolors=FREE, edgecolors=FREE_EDGE)
        axes.add_collection(self.squares)

    def show(self, identity: NDArray[np.int8], state: NDArray[np.int8]) -> None:
        """Colour the squares by what each cell reports, both of shape (C,)."""
        looks = [_look(*held) for held in zip(identity.tolist(), state.tolist(), strict=True)]
        faces, edges, widths = zip(*looks, strict=True)
        self.squares.set_facecolor(faces)
        self.squares.set_edgecolor(edges)
        self.squares.set_linewidth(widths)


def held_legend() -> list[Artist]:
    """What the squares mean, in grey."""
    looks = {"under it": wire.UNDER, "promised to it": wire.PROMISED, "near it": wire.NEAR}
    return [
        Patch(facecolor=face, edgecolor=edge, linewidth=width, label=f"cell {name}")
        for name, state in looks.items()
        for face, edge, width in [_in_colour(FAINT, state)]
    ]


def _look(identity: int, state: int) -> tuple[str, str, float]:
    if not identity or state == wire.NONE:
        return FREE, FREE_EDGE, PLAIN_WIDTH
    return _in_colour(parcel_colour(identity - 1), state)


def _in_colour(colour: str, state: int) -> tuple[str, str, float]:
    """Face, edge and the edge's width [points]."""
    if state == wire.PROMISED:
        return "white", colour, PROMISED_WIDTH
    share = UNDER_SHARE if state == wire.UNDER else NEAR_SHARE
    return tint(colour, share), tint(colour, share + 0.1), PLAIN_WIDTH
