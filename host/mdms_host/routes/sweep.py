"""The tiles that a moving outline meets, and over which share of its move."""

from typing import NamedTuple

import numpy as np

from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled

#: Outlines that reach less far into a tile only touch it [m].
TOUCH_M = 1e-9
#: A turning outline is taken piece by piece, each as if it did not turn, and larger instead [rad].
PIECE_RAD = 0.05
#: Turning corners are looked at so often, since they reach out by a micrometre between [rad].
FINE_RAD = 0.005
#: Half-planes along x and y, which the sides of tiles add to those of an outline.
_SIDES = 4


Place = tuple[float, float]
#: How far an outline reaches from its centre along x and against it, along y and against it [m].
Reaches = tuple[float, float, float, float]
#: The side of tiles [m], and how many columns and rows of them there are.
Grid = tuple[float, int, int]


class Body(NamedTuple):
    """A convex outline about its centre, in its own frame [m]."""

    normals: Floats
    """Outward unit normals of its sides, (E, 2)."""
    distances_m: Floats
    """Of the sides from the centre, (E,)."""
    corners_m: Floats
    """(C, 2)."""
    bend_m: float
    """Farthest corner from the centre; 0 for a disc, which looks the same however it turns."""


class Swept(NamedTuple):
    """Tiles (T, 2) by column and row, met from one share of the move to another, both (T,)."""

    places: Ints
    enters: Floats
    leaves: Floats


class Sweeps(NamedTuple):
    """Tiles (V,) by number that are met on several ways, from one share of each to another.

    `first` has the first of each way, and their number, (M + 1,).
    """

    first: Ints
    tile: Ints
    enters: Floats
    leaves: Floats


@compiled
def sweeps(body: Body, starts: Floats, ends: Floats, grown_m: float, grid: Grid) -> Sweeps:
    """The result of `swept` for each of several ways (M, 3), by numbers along x first.

    Tiles beyond the grid are left out.
    """
    side_m, columns, rows = grid
    parts = [swept(body, starts[way], ends[way], grown_m, side_m) for way in range(len(starts))]
    most = 0
    for part in parts:
        most += len(part.enters)
    first, tile = np.zeros(len(parts) + 1, np.int64), np.empty(most, np.int64)
    enters, leaves = np.empty(most), np.empty(most)
    count = 0
    for way, part in enumerate(parts):
        for index in range(len(part.enters)):
            column, row = part.places[index, 0], part.places[index, 1]
            if 0 <= column < columns and 0 <= row < rows:
                tile[count] = row * columns + column
                enters[count], leaves[count] = part.enters[index], part.leaves[index]
                count += 1
        first[way + 1] = count
    return Sweeps(first, tile[:count], enters[:count], leaves[:count])


@compiled
def swept(body: Body, start: Floats, end: Floats, grown_m: float, side_m: float) -> Swept:
    """The tiles met by an outline, grown by `grown_m`, on the straight way between two poses.

    Poses are (x, y, yaw), in a frame in whose origin tile (0, 0) has its corner. A tile that is
    left and met again counts as met all the while.
    """
    turn_rad = end[2] - start[2] if body.bend_m > 0.0 else 0.0
    pieces = max(int(np.ceil(abs(turn_rad) / PIECE_RAD)), 1)
    grown_m = grown_m + body.bend_m * abs(turn_rad) / pieces / 2
    reach_m = np.sqrt((body.corners_m**2).sum(axis=1).max()) + grown_m
    whole = piece_box(start, end, (0.0, 1.0), (reach_m, reach_m, reach_m, reach_m), side_m)
    low_column, low_row = whole[0], whole[2]
    columns, rows = whole[1] - low_column + 1, whole[3] - low_row + 1
    enters, leaves = np.full((columns, rows), 2.0), np.full((columns, rows), -1.0)
    way_x_m, way_y_m = end[0] - start[0], end[1] - start[1]
    first_rad = start[2] if body.bend_m > 0.0 else 0.0
    all_planes = np.empty((pieces, len(body.distances_m) + _SIDES, 3))
    for piece in range(pieces):
        yaw_rad = first_rad + turn_rad * (piece + 0.5) / pieces
        half_planes(body, yaw_rad, grown_m, side_m, all_planes[piece])
    # Forth for when tiles are entered, back for when they are left: between they count as met.
    for index in range(1 if pieces == 1 else 2 * pieces):
        forth, piece = index < pieces, index if index < pieces else 2 * pieces - 1 - index
        planes = all_planes[piece]
        first, last = piece / pieces, (piece + 1) / pieces
        reaches_m = planes[0, 2], planes[1, 2], planes[2, 2], planes[3, 2]
        near = piece_box(start, end, (first, last), reaches_m, side_m)
        for column in range(max(near[0] - low_column, 0), min(near[1] - low_column + 1, columns)):
            x_m = (low_column + column + 0.5) * side_m - start[0]
            for row in range(max(near[2] - low_row, 0), min(near[3] - low_row + 1, rows)):
                entered = leaves[column, row] >= 0.0
                if entered == forth or (entered and leaves[column, row] > first):
                    continue
                y_m = (low_row + row + 0.5) * side_m - start[1]
                low, high = met(planes, (x_m, y_m), (way_x_m, way_y_m), (first, last))
                if low <= high:
                    enters[column, row] = min(enters[column, row], low)
                    leaves[column, row] = high
    count = (leaves >= 0.0).sum()
    found = Swept(np.empty((count, 2), np.int64), np.empty(count), np.empty(count))
    index = 0
    for column in range(columns):
        for row in range(rows):
            if leaves[column, row] >= 0.0:
                found.places[index, 0], found.places[index, 1] = low_column + column, low_row + row
                found.enters[index] = enters[column, row]
                found.leaves[index] = leaves[column, row]
                index += 1
    return found


@compiled
def piece_box(
    start: Floats, end: Floats, shares: tuple[float, float], reaches_m: Reaches, side_m: float
) -> tuple[int, int, int, int]:
    """First and last column, first and last row that a part of a way may meet."""
    x_m, y_m = start[0], start[1]
    way_x_m, way_y_m = end[0] - x_m, end[1] - y_m
    from_x_m, to_x_m = x_m + shares[0] * way_x_m, x_m + shares[1] * way_x_m
    from_y_m, to_y_m = y_m + shares[0] * way_y_m, y_m + shares[1] * way_y_m
    return (
        int(np.floor((min(from_x_m, to_x_m) - reaches_m[1]) / side_m)),
        int(np.floor((max(from_x_m, to_x_m) + reaches_m[0]) / side_m)),
        int(np.floor((min(from_y_m, to_y_m) - reaches_m[3]) / side_m)),
        int(np.floor((max(from_y_m, to_y_m) + reaches_m[2]) / side_m)),
    )


@compiled
def met(
    planes: Floats, away_m: Place, way_m: Place, shares: tuple[float, float]
) -> tuple[float, float]:
    """From which share of a way to which a tile is met, between two; from more to less: never.

    `away_m` is from the start of the way to the tile's middle.
    """
    low, high = shares
    for plane in range(len(planes)):
        x, y, reach_m = planes[plane, 0], planes[plane, 1], planes[plane, 2]
        # The tile is met while this is above 0: it falls by so much along the way.
        reaching_m = reach_m - x * away_m[0] - y * away_m[1]
        falls_m = -x * way_m[0] - y * way_m[1]
        if abs(falls_m) < 1e-12:
            if reaching_m <= 0.0:
                return 1.0, 0.0
        elif falls_m > 0.0:
            high = min(high, reaching_m / falls_m)
        else:
            low = max(low, reaching_m / falls_m)
        if low > high:
            break
    return low, high


@compiled
def half_planes(body: Body, yaw_rad: float, grown_m: float, side_m: float, planes: Floats) -> None:
    """Set (nx, ny, d): the outline meets a tile where n (tile - centre) <= d for all of them."""
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    sides = len(body.distances_m)
    for index in range(sides):
        own_x, own_y = body.normals[index, 0], body.normals[index, 1]
        x, y = cosine * own_x - sine * own_y, sine * own_x + cosine * own_y
        tile_m = (abs(x) + abs(y)) * side_m / 2
        planes[_SIDES + index, 0], planes[_SIDES + index, 1] = x, y
        planes[_SIDES + index, 2] = body.distances_m[index] + grown_m + tile_m - TOUCH_M
    for index in range(_SIDES):
        x, y = (1.0, 0.0) if index < 2 else (0.0, 1.0)
        if index % 2:
            x, y = -x, -y
        reach_m = -np.inf
        for corner in range(len(body.corners_m)):
            corner_x_m, corner_y_m = body.corners_m[corner, 0], body.corners_m[corner, 1]
            own_x = cosine * corner_x_m - sine * corner_y_m
            own_y = sine * corner_x_m + cosine * corner_y_m
            reach_m = max(reach_m, x * own_x + y * own_y)
        # These come first, for they leave out most tiles.
        planes[index, 0], planes[index, 1] = x, y
        planes[index, 2] = reach_m + grown_m + side_m / 2 - TOUCH_M


@compiled
def overhangs_m(
    body: Body, starts: Floats, ends: Floats, half_x_m: float, half_y_m: float
) -> Floats:
    """The result of `overhang_m` for each of several ways (M, 3), shape (M,)."""
    overhangs = np.empty(len(starts))
    for way in range(len(starts)):
        overhangs[way] = overhang_m(body, starts[way], ends[way], half_x_m, half_y_m)
    return overhangs


@compiled
def overhang_m(body: Body, start: Floats, end: Floats, half_x_m: float, half_y_m: float) -> float:
    """How far the outline hangs over the edge of a table about the origin at most on a way [m].

    Negative: at least so far inside. Poses are in the table frame.
    """
    corners_m2 = (body.corners_m**2).sum(axis=1).max()
    over_x_m = max(abs(start[0]), abs(end[0])) - half_x_m
    over_y_m = max(abs(start[1]), abs(end[1])) - half_y_m
    most_m = max(over_x_m, over_y_m) + np.sqrt(corners_m2)
    if most_m <= 0.0:
        return float(most_m)
    turn_rad = end[2] - start[2] if body.bend_m > 0.0 else 0.0
    pieces = max(int(np.ceil(abs(turn_rad) / FINE_RAD)), 1)
    worst_m = -np.inf
    for piece in range(pieces + 1):
        share = piece / pieces
        cosine, sine = np.cos(start[2] + share * turn_rad), np.sin(start[2] + share * turn_rad)
        x_m = start[0] + share * (end[0] - start[0])
        y_m = start[1] + share * (end[1] - start[1])
        for corner in body.corners_m:
            corner_x_m = x_m + cosine * corner[0] - sine * corner[1]
            corner_y_m = y_m + sine * corner[0] + cosine * corner[1]
            worst_m = max(worst_m, abs(corner_x_m) - half_x_m, abs(corner_y_m) - half_y_m)
    return float(worst_m)
