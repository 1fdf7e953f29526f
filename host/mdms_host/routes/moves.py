"""All moves of a shape along its lattice: how long they take, and when they are on which tiles."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mdms_host.routes.grid import LINES, Lattice
from mdms_host.routes.route import Pace
from mdms_host.routes.support import ShapeSupport
from mdms_host.routes.sweep import PIECE_RAD, Swept, swept
from mdms_model.arrays import Bools, Floats, Ints

#: Lines of moves: eight straight ones, then a turn to the next yaw and one to the yaw before.
TURNS = (len(LINES), len(LINES) + 1)
LINE_COUNT = len(LINES) + len(TURNS)


class Met(NamedTuple):
    """The tiles that each of several moves meets, and from when to when after its begin, (V,)."""

    first: Ints
    """The first of each move, and their number, (M + 1,)."""
    tile: Ints
    enters_s: Floats
    leaves_s: Floats


class Moves(NamedTuple):
    """Kinds of moves (K,), by the yaw of the node that they start at.

    The tiles that they meet are by their numbers less that of the node's own.
    """

    first: Ints
    """The first kind of each yaw, and their number, (yaws + 1,)."""
    far: Ints
    """The number of the node it ends at less that of the one it starts at, (K,)."""
    line: Ints
    steps: Ints
    duration_s: Floats
    met: Met
    often: Bools
    """Which kinds are used from anywhere, (K,); others only lead to where the goal is in line."""
    back_first: Ints
    """The first of `back` by the yaw that a kind ends at, (yaws + 1,)."""
    back: Ints
    """Kinds by that yaw, those that are used often first."""
    back_often: Ints
    """Where of each yaw these end, (yaws,)."""
    unit: Ints
    """The kind of one step along each line of a yaw, -1 for none, (yaws, lines)."""
    beyond: Ints
    """The first of `beyond_tile` of each kind, and their number, (K + 1,)."""
    beyond_tile: Ints
    """Tiles of kinds of one step that are under a parcel neither before it nor after it."""


class MoveKind(NamedTuple):
    """One kind of move, before all are put together."""

    yaw: int
    ends_at: int
    far: int
    line: int
    steps: int
    length_m: float
    turn_m: float
    swept: Swept


@dataclass(frozen=True)
class LatticeMoves:
    """The moves of a lattice, and along which lines each node may be left at all.

    `open_lines` (lines, nodes) is whether one step from a node stays on the table and stands.
    """

    lattice: Lattice
    moves: Moves
    open_lines: Bools
    on_table: Bools
    poses: Floats
    stand: Ints
    stand_tile: Ints
    """The tiles under a parcel at rest, less the node's own; `stand` has the first of each yaw."""


#: Steps of moves that are used often.
_OFTEN = (1, 2, 4, 8, 16, 32, 64)


def lattice_moves(lattice: Lattice, standing: ShapeSupport, pace: Pace) -> LatticeMoves:
    """Work out all moves of a lattice."""
    kinds = [kind for yaw in range(len(lattice.yaws_rad)) for kind in _kinds_of(lattice, yaw)]
    on_table = _on_table(lattice)
    open_lines = _open_lines(lattice, standing, kinds, on_table)
    stands = [_standing_tiles(lattice, yaw) for yaw in range(len(lattice.yaws_rad))]
    moves = _together(lattice, kinds, stands, pace)
    return LatticeMoves(
        lattice,
        moves,
        open_lines,
        on_table,
        poses=lattice.poses,
        stand=np.cumsum([0, *map(len, stands)]).astype(np.int64),
        stand_tile=np.concatenate(stands),
    )


def _standing_tiles(lattice: Lattice, yaw: int) -> Ints:
    pose = np.array([*lattice.offsets_m[yaw], lattice.yaws_rad[yaw]])
    body, side_m = lattice.shape.body, lattice.tiles.side_m
    column, row = swept(body, pose, pose, lattice.clearance_m, side_m).places.T
    tiles: Ints = row * lattice.tiles.columns + column
    return tiles


def _kinds_of(lattice: Lattice, yaw: int) -> list[MoveKind]:
    """All moves that begin at one yaw."""
    kinds: list[MoveKind] = []
    for line in range(len(LINES)):
        kinds += _straight_kinds(lattice, yaw, line)
    for line, other in zip(TURNS, (yaw + 1, yaw - 1), strict=True):
        if 0 <= other < len(lattice.yaws_rad):
            kinds.append(_turn_kind(lattice, yaw, other, line))
    return kinds


def _straight_kinds(lattice: Lattice, yaw: int, line: int) -> list[MoveKind]:
    """Moves of 1, 2, ... steps along a line, as parts of the longest."""
    along, across = LINES[line]
    most = min(
        lattice.columns - 1 if along else lattice.columns + lattice.rows,
        lattice.rows - 1 if across else lattice.columns + lattice.rows,
    )
    if most < 1:
        return []
    step_m = lattice.step * lattice.tiles.side_m
    start = np.array([*lattice.offsets_m[yaw], lattice.yaws_rad[yaw]])
    end = start + np.array([along, across, 0.0]) * most * step_m
    body, side_m = lattice.shape.body, lattice.tiles.side_m
    ray = swept(body, start, end, lattice.clearance_m, side_m)
    far, length_m = across * lattice.columns + along, float(np.hypot(along, across)) * step_m
    kinds = []
    for steps in range(1, most + 1):
        met = ray.enters * most < steps
        enters, leaves = ray.enters[met] * most / steps, ray.leaves[met] * most / steps
        part = Swept(ray.places[met], enters, np.minimum(leaves, 1.0))
        kinds.append(MoveKind(yaw, yaw, far * steps, line, steps, length_m * steps, 0.0, part))
    return kinds


def _turn_kind(lattice: Lattice, yaw: int, other: int, line: int) -> MoveKind:
    """A quarter turn, and the half of a tile or so by which the places of the yaws differ."""
    start, end = (np.array([*lattice.offsets_m[at], lattice.yaws_rad[at]]) for at in (yaw, other))
    met = swept(lattice.shape.body, start, end, lattice.clearance_m, lattice.tiles.side_m)
    length_m = float(np.hypot(*(end - start)[:2]))
    turn_m = abs(end[2] - start[2]) * lattice.shape.body.bend_m
    return MoveKind(yaw, other, (other - yaw) * lattice.places, line, 1, length_m, turn_m, met)


def _beyond(lattice: Lattice, kind: MoveKind, stands: Sequence[Ints]) -> Ints:
    """`Moves.beyond_tile` of one kind."""
    if kind.steps > 1:
        return np.zeros(0, dtype=np.int64)
    columns = lattice.tiles.columns
    along, across = LINES[kind.line] if kind.line < len(LINES) else (0, 0)
    after = stands[kind.ends_at] + (across * columns + along) * lattice.step
    met = kind.swept.places[:, 1] * columns + kind.swept.places[:, 0]
    return np.setdiff1d(met, np.concatenate((stands[kind.yaw], after)))


def _together(lattice: Lattice, kinds: list[MoveKind], stands: Sequence[Ints], pace: Pace) -> Moves:
    """All kinds in arrays."""
    beyond = [_beyond(lattice, kind, stands) for kind in kinds]
    yaws = len(lattice.yaws_rad)
    counts = [len(kind.swept.enters) for kind in kinds]
    lengths_m = np.array([kind.length_m for kind in kinds])
    turns_m = np.array([kind.turn_m for kind in kinds])
    places = np.concatenate([np.zeros((0, 2), np.int64), *(kind.swept.places for kind in kinds)])
    enters = np.concatenate([np.zeros(0), *(kind.swept.enters for kind in kinds)])
    leaves = np.concatenate([np.zeros(0), *(kind.swept.leaves for kind in kinds)])
    own = np.repeat(lengths_m, counts), np.repeat(turns_m, counts)
    ends = np.array([kind.ends_at for kind in kinds], dtype=np.int64)
    steps = np.array([kind.steps for kind in kinds], dtype=np.int64)
    often = np.isin(steps, _OFTEN)
    back_first = np.searchsorted(np.sort(ends), np.arange(yaws + 1)).astype(np.int64)
    unit = np.full((yaws, LINE_COUNT), -1, dtype=np.int64)
    for index, kind in enumerate(kinds):
        if kind.steps == 1:
            unit[kind.yaw, kind.line] = index
    return Moves(
        first=np.searchsorted([kind.yaw for kind in kinds], np.arange(yaws + 1)).astype(np.int64),
        far=np.array([kind.far for kind in kinds], dtype=np.int64),
        line=np.array([kind.line for kind in kinds], dtype=np.int64),
        steps=steps,
        duration_s=pace.times_s(lengths_m, turns_m, np.ones(len(kinds))),
        met=Met(
            first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            tile=places[:, 1] * lattice.tiles.columns + places[:, 0],
            enters_s=pace.times_s(*own, enters),
            leaves_s=pace.times_s(*own, leaves),
        ),
        often=often,
        back_first=back_first,
        back=np.lexsort((~often, ends)).astype(np.int64),
        back_often=back_first[:-1] + np.bincount(ends[often], minlength=yaws),
        unit=unit,
        beyond=np.cumsum([0, *map(len, beyond)]).astype(np.int64),
        beyond_tile=np.concatenate([np.zeros(0, np.int64), *beyond]),
    )


def _on_table(lattice: Lattice) -> Bools:
    """At which nodes the whole outline is on the table, shape (count,)."""
    half_m = np.array(lattice.tiles.half_table_m) + 1e-9
    inside = np.zeros(lattice.count, dtype=bool)
    for yaw, yaw_rad in enumerate(lattice.yaws_rad):
        own = slice(yaw * lattice.places, (yaw + 1) * lattice.places)
        low_m, high_m = _extent_m(lattice, yaw_rad)
        places_m = lattice.poses[own, :2]
        inside[own] = ((places_m + high_m <= half_m) & (places_m + low_m >= -half_m)).all(axis=1)
    return inside


def _extent_m(lattice: Lattice, yaw_rad: float) -> tuple[Floats, Floats]:
    """Least and greatest x and y of the outline about its centre, turned so."""
    turned_m = lattice.shape.footprint.outline_m(np.array([0.0, 0.0, yaw_rad]))
    return turned_m.min(axis=0), turned_m.max(axis=0)


def _open_lines(
    lattice: Lattice, standing: ShapeSupport, kinds: list[MoveKind], on_table: Bools
) -> Bools:
    """Along which lines a parcel at a node may go one step, shape (lines, count)."""
    open_lines = np.zeros((LINE_COUNT, lattice.count), dtype=bool)
    places = np.arange(lattice.places)
    rows, columns = np.divmod(places, lattice.columns)
    for kind in kinds:
        if kind.steps > 1:
            continue
        along, across = LINES[kind.line] if kind.line < len(LINES) else (0, 0)
        there = (columns + along >= 0) & (columns + along < lattice.columns)
        there &= (rows + across >= 0) & (rows + across < lattice.rows)
        nodes = kind.yaw * lattice.places + places[there]
        nodes = nodes[on_table[nodes] & on_table[nodes + kind.far]]
        if kind.line in TURNS:
            nodes = nodes[_turn_on_table(lattice, nodes, kind.far)]
        open_lines[kind.line, _standing(lattice, standing, nodes, kind.far)] = True
    return open_lines


def _turn_on_table(lattice: Lattice, nodes: Ints, far: int) -> Bools:
    """At which of these nodes the outline stays on the table while it turns."""
    half_m = np.array(lattice.tiles.half_table_m) + 1e-9
    inside = np.ones(len(nodes), dtype=bool)
    if not len(nodes):
        return inside
    start, way = lattice.poses[nodes], lattice.poses[nodes + far] - lattice.poses[nodes]
    for share in np.linspace(0.0, 1.0, int(np.pi / 2 / PIECE_RAD) + 2):
        low_m, high_m = _extent_m(lattice, start[0, 2] + share * way[0, 2])
        places_m = start[:, :2] + share * way[:, :2]
        inside &= ((places_m + high_m <= half_m) & (places_m + low_m >= -half_m)).all(axis=1)
    return inside


def _standing(lattice: Lattice, standing: ShapeSupport, nodes: Ints, far: int) -> Ints:
    """Those of these nodes from which the step stands; cells are alike, so that few are tried."""
    if not len(nodes):
        return nodes
    alike = lattice.tiles.per_pitch // lattice.step
    rows, columns = np.divmod(nodes % lattice.places, lattice.columns)
    groups = rows % alike * alike + columns % alike
    fit = [
        nodes[groups == group]
        for group in np.unique(groups)
        if standing.stands(
            lattice.poses[nodes[groups == group][0]], lattice.poses[nodes[groups == group][0] + far]
        )
    ]
    return np.concatenate([np.zeros(0, np.int64), *fit])
