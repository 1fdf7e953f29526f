"""The way of a parcel: a polyline of poses; x, y and yaw change evenly along each piece."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, hypot, pi

import numpy as np

from mdms_model.arrays import Floats

#: Pieces are of one direction when their unit vectors differ by less than this.
_STRAIGHT = 1e-6
#: Poses nearer to each other than this are one [m].
_SAME_M = 1e-9
#: A parcel turns the shorter way to a pose: that is the way of a path up to such a turn.
_CLEAR_RAD = 0.9 * pi


@dataclass(frozen=True, slots=True)
class Piece:
    """A straight part of a path, from path coordinate to path coordinate [m].

    `direction` is the pose's change per metre of path, shape (3,) [1, 1, rad/m].
    """

    start_s_m: float
    end_s_m: float
    start: Floats
    direction: Floats

    def pose_at(self, s_m: float) -> Floats:
        """The pose at a path coordinate, shape (3,)."""
        pose: Floats = self.start + (s_m - self.start_s_m) * self.direction
        return pose


class Path:
    """Poses (K, 3) [m, m, rad; table frame], joined by straight pieces; yaw does not wrap.

    The path coordinate s runs from 0 to `length_m` [m]: the way of the centre and that of a corner,
    `reach_m` from it, by Pythagoras. Poses that coincide are one, and pieces of one direction are
    one piece. Raises ValueError for anything but finite poses.
    """

    def __init__(self, poses: Floats, reach_m: float) -> None:
        poses = np.asarray(poses, dtype=np.float64)
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or not np.isfinite(poses).all():
            raise ValueError(f"a path is of finite poses (K, 3), K at least 1; got {poses}")
        self.reach_m = reach_m
        self.start: Floats = poses[0]
        self.pieces: tuple[Piece, ...] = tuple(_pieces(poses, np.array([1.0, 1.0, reach_m])))
        self.length_m = self.pieces[-1].end_s_m if self.pieces else 0.0

    @property
    def end(self) -> Floats:
        """The last pose, shape (3,)."""
        return self.pose_at(self.length_m)

    @property
    def corners_m(self) -> tuple[float, ...]:
        """Path coordinates at which the direction changes, and that of the end."""
        return tuple(piece.end_s_m for piece in self.pieces) or (0.0,)

    @property
    def legs_m(self) -> tuple[float, ...]:
        """Path coordinates of single poses to go to: the corners, and the middle of a half turn.

        A half turn to its end might as well be taken the other way round.
        """
        ends_m: list[float] = []
        for piece in self.pieces:
            length_m = piece.end_s_m - piece.start_s_m
            turn_rad = abs(float(piece.direction[2])) * length_m
            parts = max(ceil(turn_rad / _CLEAR_RAD), 1)
            ends_m += [piece.start_s_m + length_m * part / parts for part in range(1, parts)]
            ends_m.append(piece.end_s_m)
        return tuple(ends_m) or (0.0,)

    def piece_at(self, s_m: float) -> Piece | None:
        """The piece that goes on from a path coordinate; None on a path without length."""
        for piece in self.pieces:
            if s_m < piece.end_s_m:
                return piece
        return self.pieces[-1] if self.pieces else None

    def pose_at(self, s_m: float) -> Floats:
        """The pose at a path coordinate; beyond an end, the pose there, shape (3,)."""
        piece = self.piece_at(s_m)
        if piece is None:
            return self.start
        return piece.pose_at(min(max(s_m, 0.0), self.length_m))

    def direction_at(self, s_m: float) -> Floats:
        """Change of the pose per metre from a path coordinate on, shape (3,); zero without one."""
        piece = self.piece_at(s_m)
        return np.zeros(3) if piece is None else piece.direction

    def off(self, pose: Floats, s_m: float) -> Floats:
        """From a pose to that at a path coordinate, the shorter turn, shape (3,)."""
        off: Floats = self.pose_at(s_m) - pose
        off[2] = shorter_turn_rad(0.0, off[2])
        return off

    def distance_m(self, off: Floats) -> float:
        """How far such a difference of poses is, a corner's way included [m]."""
        x_m, y_m, yaw_rad = off.tolist()
        return hypot(x_m, y_m, self.reach_m * yaw_rad)

    def speed_m_s(self, twist: Floats, s_m: float) -> float:
        """How fast a parcel of this twist goes along the path [m/s]."""
        return float((twist * (1.0, 1.0, self.reach_m**2)) @ self.direction_at(s_m))

    def nearest_m(self, pose: Floats, low_m: float, high_m: float) -> float:
        """The path coordinate, of those from low to high, whose pose is nearest to this [m]."""
        best_m, least_m = low_m, self.distance_m(self.off(pose, low_m))
        metric = np.array([1.0, 1.0, self.reach_m**2])
        for piece in self.pieces:
            first_m, last_m = max(piece.start_s_m, low_m), min(piece.end_s_m, high_m)
            if first_m >= last_m:
                continue
            ahead_m = -float(self.off(pose, first_m) @ (metric * piece.direction))
            s_m = min(first_m + max(ahead_m, 0.0), last_m)
            away_m = self.distance_m(self.off(pose, s_m))
            if away_m < least_m:
                best_m, least_m = s_m, away_m
        return best_m


def shorter_turn_rad(from_rad: float, to_rad: float) -> float:
    """The shorter turn from one yaw to another [rad], from -pi up to pi."""
    return (to_rad - from_rad + pi) % (2 * pi) - pi


def _pieces(poses: Floats, extent_m: Floats) -> Iterator[Piece]:
    at_s_m = 0.0
    open_: Piece | None = None
    for before, after in pairwise(poses):
        length_m = hypot(*((after - before) * extent_m).tolist())
        if length_m < _SAME_M:
            continue
        direction = (after - before) / length_m
        end_s_m = at_s_m + length_m
        if open_ is not None and _alike(open_.direction, direction, extent_m):
            open_ = Piece(open_.start_s_m, end_s_m, open_.start, open_.direction)
        else:
            if open_ is not None:
                yield open_
            open_ = Piece(at_s_m, end_s_m, before, direction)
        at_s_m = end_s_m
    if open_ is not None:
        yield open_


def _alike(one: Floats, other: Floats, extent_m: Floats) -> bool:
    return hypot(*((one - other) * extent_m).tolist()) < _STRAIGHT
