"""One parcel's way map: the lattice of its shape, with its start and its goal joined to it."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mdms_host.routes.moves import LatticeMoves, Met, Moves
from mdms_host.routes.route import Pace
from mdms_host.routes.support import SLACK_M, ShapeSupport
from mdms_host.routes.sweep import Sweeps
from mdms_model.arrays import Bools, Floats, Ints

#: Start and goal are joined to so many places of the lattice along x, and so many along y.
_WINDOW = 3
#: The farthest turn on the way to the lattice: a quarter, and some.
_TURN_RAD = np.deg2rad(100.0)
#: A start or goal that hangs over the table's edge may do so a hair more on its way [m].
_HAIR_M = 1e-6


class Joins(NamedTuple):
    """Single moves (J,) between nodes of which at least one is no lattice node.

    Nodes that are not of the lattice have their tiles in `stand_tile`, by `stand` (extras + 1,).
    """

    start: Ints
    end: Ints
    tips: Bools
    """Which are left out, for the parcel may tip on them."""
    duration_s: Floats
    met: Met
    first: Ints
    """The first of `onward` of each node, and their number, (nodes + 1,)."""
    onward: Ints
    """Joins by the node they start at, (J,)."""
    back_first: Ints
    back: Ints
    """Joins by the node they end at, (J,)."""
    stand: Ints
    stand_tile: Ints


class Graph(NamedTuple):
    """Arrays of a roadmap for compiled searches.

    Nodes from `bases.size` on are not of the lattice. `aligned` nodes are in a row or column of a
    node that the goal is joined to.
    """

    moves: Moves
    bases: Ints
    places: int
    stand: Ints
    """The first of `stand_tile` by yaw of the lattice, and their number, (yaws + 1,)."""
    stand_tile: Ints
    aligned: Bools
    joins: Joins


@dataclass
class Roadmap:
    """The lattice's nodes, then start, goal and the nodes between, as poses and joins."""

    ways: LatticeMoves
    standing: ShapeSupport
    pace: Pace
    start: Floats
    goal: Floats
    leaves: bool = False
    """Whether it leaves the table at its goal, over whose edge it may hang or tip."""
    hangs: bool = False
    """Whether it may hang over the edge as far as the rim of tiles wherever it is joined."""
    extras: list[Floats] = field(init=False)
    pairs: list[tuple[int, int]] = field(init=False)
    graph: Graph = field(init=False)
    _need_m: float = field(init=False)

    def __post_init__(self) -> None:
        self.extras = [self.start, self.goal]
        self.pairs = [(self.start_node, self.goal_node)]
        self._add_corners()
        self._add_windows()
        self._need_m = self.standing.need_m
        if not self.standing.stands(self.start, self.start):
            self._need_m = self.standing.least_margin_m(self.start, self.start) - SLACK_M
        self.pairs = self._on_table()
        self.graph = self._graph()

    @property
    def start_node(self) -> int:
        """The number of the start."""
        return self.ways.lattice.count

    @property
    def goal_node(self) -> int:
        """The number of the goal."""
        return self.ways.lattice.count + 1

    def pose(self, node: int) -> Floats:
        """The pose of a node [table frame], shape (3,)."""
        count = self.ways.lattice.count
        return self.extras[node - count] if node >= count else self._poses[node]

    def is_safe(self, moves: Ints) -> bool:
        """Whether the parcel is safe from tipping on the joins among the moves of a way.

        Unsafe joins are left out from now on: safety is checked only here.
        """
        joins = [move for move in moves.tolist() if move < len(self.pairs)]
        tips = [join for join in joins if not self._safe(*self.pairs[join])]
        self.graph.joins.tips[tips] = True
        return not tips

    @property
    def _poses(self) -> Floats:
        return self.ways.poses

    def _add_corners(self) -> None:
        """The corners of both ways along x and y, turned as at the start or as at the goal."""
        start, goal = self.start, self.goal
        turned = [start[2]] if start[2] == goal[2] else [start[2], goal[2]]
        for x_m, y_m in ((goal[0], start[1]), (start[0], goal[1])):
            for yaw_rad in turned:
                node = self.start_node + len(self.extras)
                self.extras.append(np.array([x_m, y_m, yaw_rad]))
                self.pairs += [(self.start_node, node), (node, self.goal_node)]

    def _add_windows(self) -> None:
        near = self.ways.lattice.near
        for node in near(self.start, _WINDOW, _TURN_RAD).tolist():
            if self.ways.on_table[node]:
                self.pairs.append((self.start_node, node))
        for node in near(self.goal, _WINDOW, _TURN_RAD).tolist():
            if self.ways.on_table[node]:
                self.pairs.append((node, self.goal_node))

    def _on_table(self) -> list[tuple[int, int]]:
        """The pairs between which the way hangs over the edge no more than it may.

        That is as far as its own end does, the start or the goal, or as far as the rim of tiles.
        Beyond the rim no goal may hang, since nothing keeps others apart from it there.
        """
        starts, ends = self._ends()
        over_m = self.standing.overhangs_m(starts, ends)
        own = np.array([self.start, self.goal])
        at_start_m, at_goal_m = np.maximum(self.standing.overhangs_m(own, own), 0.0)
        rim_m = self.ways.lattice.tiles.rim_m - self.ways.lattice.clearance_m
        if at_goal_m > rim_m:
            at_goal_m = 0.0
        least_m = rim_m if self.hangs else 0.0
        return [
            (start, end)
            for (start, end), way_m in zip(self.pairs, over_m.tolist(), strict=True)
            if (self.leaves and end == self.goal_node)
            or way_m
            <= _HAIR_M
            + max(
                least_m,
                at_start_m if start == self.start_node else 0.0,
                at_goal_m if end == self.goal_node else 0.0,
            )
        ]

    def _ends(self) -> tuple[Floats, Floats]:
        """The poses at which the pairs start and end, both (J, 3)."""
        starts, ends = np.array(self.pairs, dtype=np.int64).reshape(-1, 2).T
        poses = np.concatenate((self._poses, np.array(self.extras)))
        return poses[starts], poses[ends]

    def _safe(self, start: int, end: int) -> bool:
        """Whether the parcel is no nearer to tipping on the way between two nodes than allowed.

        A parcel that is nearer at its start may go on from there.
        """
        if self.leaves and end == self.goal_node:
            return True
        need_m = self._need_m if start == self.start_node else None
        return self.standing.stands(self.pose(start), self.pose(end), need_m)

    def _graph(self) -> Graph:
        lattice = self.ways.lattice
        aligned = np.zeros(lattice.count, dtype=bool)
        rows, columns = np.divmod(np.arange(lattice.count) % lattice.places, lattice.columns)
        for start, end in self.pairs:
            if end == self.goal_node and start < lattice.count:
                aligned |= (rows == rows[start]) | (columns == columns[start])
        return Graph(
            self.ways.moves,
            lattice.bases,
            lattice.places,
            self.ways.stand,
            self.ways.stand_tile,
            aligned,
            self._joins(),
        )

    def _joins(self) -> Joins:
        starts = np.array([start for start, _ in self.pairs], dtype=np.int64)
        ends = np.array([end for _, end in self.pairs], dtype=np.int64)
        from_poses, to_poses = self._ends()
        ways = to_poses - from_poses
        lengths_m = np.hypot(ways[:, 0], ways[:, 1])
        turns_m = np.abs(ways[:, 2]) * self.standing.shape.body.bend_m
        met = self._swept(from_poses, to_poses)
        own = np.repeat(lengths_m, np.diff(met.first)), np.repeat(turns_m, np.diff(met.first))
        extras = np.array(self.extras)
        stands = self._swept(extras, extras)
        nodes = np.arange(self.ways.lattice.count + len(self.extras) + 1)
        return Joins(
            start=starts,
            end=ends,
            tips=np.zeros(len(ends), dtype=bool),
            duration_s=self.pace.times_s(lengths_m, turns_m, np.ones(len(starts))),
            met=Met(
                met.first,
                met.tile,
                enters_s=self.pace.times_s(*own, met.enters),
                leaves_s=self.pace.times_s(*own, met.leaves),
            ),
            first=np.searchsorted(np.sort(starts), nodes).astype(np.int64),
            onward=np.argsort(starts, kind="stable").astype(np.int64),
            back_first=np.searchsorted(np.sort(ends), nodes).astype(np.int64),
            back=np.argsort(ends, kind="stable").astype(np.int64),
            stand=stands.first,
            stand_tile=stands.tile,
        )

    def _swept(self, starts: Floats, ends: Floats) -> Sweeps:
        lattice = self.ways.lattice
        return lattice.tiles.swept(lattice.shape.body, starts, ends, lattice.clearance_m)
