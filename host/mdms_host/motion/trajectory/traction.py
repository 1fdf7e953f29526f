"""Limits of friction and motors on the motion of a parcel, along a path and in general.

From a route to moving wheels, for a program that drives many parcels:

    traction = Traction(layout, drives, friction=0.3, speed_m_s=0.5)
    path = Path(poses, outline.reach_m)                 # a route's polyline (K, 3)
    profile = traction.profile(path, outline, mass)     # friction and motors along it
    profile.duration_s                                  # how long that takes from rest to rest
    follower = Follower(traction, profile)              # `motion/follower.py`
    carried = follower.step(belief, step_s, authority_s_m)    # once a cycle
    references_m_s = carrying.references_m_s({name: carried}, outlines, places)   # all parcels

Planners call `traction.agility(outline, mass)` once for each kind of parcel. It returns how fast
the parcel may be sped up at any place, for moves that are only considered.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from math import ceil, inf

import numpy as np

from mdms_host.estimation.footprint import Footprint
from mdms_host.layout import Layout
from mdms_host.motion.trajectory.path import Path, Piece
from mdms_host.motion.trajectory.pushes import Mass, Pushes, by_parts, pushes_at
from mdms_host.motion.trajectory.speed_profile import SpeedProfile
from mdms_model.arrays import Bools, Floats
from mdms_model.motor import drive_of, rim_mass_kg
from mdms_model.scenario.scenario import Cell

#: This share of the supply is planned with; the rest is for feedback, and for supplies that sag.
_SUPPLY_SHARE = 0.85


@dataclass(frozen=True, slots=True)
class WheelDrives:
    """A rolling wheel pushes with a r - b u - m u', r its reference, u its surface speed [m/s].

    `a` and `b` are of shape (W,) [N s/m], for gains may differ; m is the inertia of rotor and wheel
    at the rim. The motor gives at most `stall_n` - `slope` u, and no more than `most_n`.
    """

    a_n_s_per_m: Floats
    b_n_s_per_m: Floats
    rim_mass_kg: float
    stall_n: float
    slope_n_s_per_m: float
    most_n: float = inf
    reference_limit_m_s: float = inf

    def references_m_s(self, speed_m_s: Floats, rate_m_s2: Floats, push_n: Floats) -> Floats:
        """References at which wheels of these speeds push so and speed up so, all (W,).

        A wheel without gain follows no reference: 0. References are held within the range of the
        wire.
        """
        force_n = self.b_n_s_per_m * speed_m_s + self.rim_mass_kg * rate_m_s2 + push_n
        driven = self.a_n_s_per_m > 0.0
        references_m_s = np.divide(
            force_n, self.a_n_s_per_m, out=np.zeros_like(force_n), where=driven
        )
        limit_m_s = self.reference_limit_m_s
        return np.clip(references_m_s, -limit_m_s, limit_m_s)

    def motor_limit_n(self, speed_m_s: Floats) -> Floats:
        """Largest force of motor, bridge and wire at a given wheel speed, either way [N]."""
        motor_n = np.minimum(self.stall_n - self.slope_n_s_per_m * speed_m_s, self.most_n)
        if self.reference_limit_m_s < inf:
            wire_n = self.a_n_s_per_m.max() * self.reference_limit_m_s
            motor_n = np.minimum(motor_n, wire_n - self.b_n_s_per_m.max() * speed_m_s)
        limit_n: Floats = motor_n
        return limit_n


def wheel_drives_of(
    cell: Cell, gains_vs_per_m: Floats, reference_limit_m_s: float = inf
) -> WheelDrives:
    """The drives of wheels whose motors are those of a cell, and whose gains are these, (W,)."""
    drive = drive_of(cell)
    ke_per_ohm = drive.ke / cell.resistance_ohm
    slope = drive.b - drive.a
    current_a = cell.current_limit_a
    return WheelDrives(
        a_n_s_per_m=gains_vs_per_m * ke_per_ohm,
        b_n_s_per_m=slope + gains_vs_per_m * ke_per_ohm,
        rim_mass_kg=rim_mass_kg(cell),
        stall_n=_SUPPLY_SHARE * cell.supply_v * ke_per_ohm,
        slope_n_s_per_m=slope,
        most_n=inf if current_a is None else _SUPPLY_SHARE * current_a * drive.ke,
        reference_limit_m_s=reference_limit_m_s,
    )


#: Share of the friction that is believed which trajectories are planned with; feedback may take
#: `FEEDBACK_SHARE` in all. Wheels and friction differ by a tenth, and references are held for a
#: cycle, in which pushes change by another.
PLANNED_SHARE = 0.62
FEEDBACK_SHARE = 0.85
#: Samples of a path are so far apart at most [m].
_STEP_M = 0.005
#: At most this share of friction is to hold a centre of mass on its circle.
_TURNING_SHARE = 0.3
#: At most this share is kept for wheels that only drag: slow, they drag with less than friction.
_DRAGGED_SHARE = 0.5
#: Fastest wheel, as a share of the motor's speed at no load.
_FASTEST_SHARE = 0.8
#: Acceleration that is planned with where no wheel can do anything [m/s2]; too little to matter.
_LEAST_M_S2 = 0.02
#: Places within a cell, and yaws, at which a kind of parcel is tried.
_PLACES = 4
_YAWS = 8


@dataclass(frozen=True, slots=True)
class Agility:
    """How fast a kind of parcel can be sped up wherever it is: the worst of many poses.

    `per_acceleration` (R, 3) maps an acceleration [m/s2, rad/s2] to shares of the friction that is
    planned with: none of them may exceed 1.
    """

    per_acceleration: Floats

    def acceleration_m_s2(self, direction: Floats) -> float:
        """The bound of s'' along a direction, the pose's change per metre of path, (3,)."""
        if not len(self.per_acceleration):  # It lies between the wheels everywhere.
            return _LEAST_M_S2
        return max(
            _LEAST_M_S2, 1.0 / max(float(abs(self.per_acceleration @ direction).max()), 1e-9)
        )


class Traction:
    """The wheels of a layout, with their drives and the friction believed, `friction`.

    Parcels are moved at `speed_m_s` at most, that of the centre and that of a corner together.
    """

    def __init__(
        self,
        layout: Layout,
        drives: WheelDrives,
        *,
        friction: float = 0.3,
        speed_m_s: float = 0.1,
        gravity_m_s2: float = 9.81,
    ) -> None:
        self.layout = layout
        self.drives = drives
        self.friction = friction
        self.speed_m_s = speed_m_s
        self._gravity_m_s2 = gravity_m_s2
        self._planned = PLANNED_SHARE * friction
        self._passive: Bools = np.zeros(len(layout.wheel_cells), dtype=bool)
        self.changes = 0

    def lose(self, cells: Collection[int]) -> None:
        """The wheels of these cells (from 1) do not push, and drag; those of all others push.

        `changes` counts such changes: results from before the last change are out of date.
        """
        self._passive = np.isin(self.layout.wheel_cells, [*cells])
        self.changes += 1

    @property
    def push_share(self) -> float:
        """Largest push of a wheel, feedback included, over its normal force."""
        return FEEDBACK_SHARE * self.friction

    def pushes(self, outline: Footprint, mass: Mass, poses: Floats) -> Pushes:
        """How the wheels share pushes at poses (K, 3)."""
        weight_n = mass.mass_kg * self._gravity_m_s2
        return pushes_at(self.layout, outline, mass, poses, weight_n, passive=self._passive)

    def profile(self, path: Path, outline: Footprint, mass: Mass) -> SpeedProfile:
        """The bounds of speed and acceleration along a path."""
        if not path.pieces:
            pushes = self.pushes(outline, mass, path.start[None, :])
            return SpeedProfile(path, np.zeros(1), np.zeros(0), np.zeros(1), ((0, pushes),))
        s_m, bounds_m_s2, caps_m_s, parts = [0.0], [], [self.speed_m_s], []
        for samples_m, piece in _samples(path):
            poses = piece.start + (samples_m - piece.start_s_m)[:, None] * piece.direction
            pushes = self.pushes(outline, mass, poses)
            bound_m_s2, cap_m_s = self._bounds(pushes, piece.direction)
            parts.append((len(s_m) - 1, pushes))
            caps_m_s[-1] = min(caps_m_s[-1], float(cap_m_s[0]))
            s_m += samples_m[1:].tolist()
            caps_m_s += cap_m_s[1:].tolist()
            bounds_m_s2.append(np.minimum(bound_m_s2[:-1], bound_m_s2[1:]))
        return SpeedProfile(
            path,
            np.array(s_m),
            np.concatenate(bounds_m_s2),
            np.array(caps_m_s),
            tuple(parts),
        )

    def agility(self, outline: Footprint, mass: Mass) -> Agility:
        """How fast a kind of parcel can be sped up, about the middle of the table, no cell lost."""
        pitch_m = self.layout.pitch_m
        inside_m = (np.arange(_PLACES) / _PLACES - 0.5) * pitch_m
        yaws_rad = np.arange(_YAWS) / _YAWS * 2 * np.pi
        # Off the round numbers, where wheels lie exactly under an edge.
        x_m, y_m, yaw_rad = np.meshgrid(inside_m + 0.003, inside_m + 0.003, yaws_rad + 0.01)
        poses = np.column_stack((x_m.ravel(), y_m.ravel(), yaw_rad.ravel()))
        pushes = pushes_at(self.layout, outline, mass, poses, mass.mass_kg * self._gravity_m_s2)
        columns = [pushes.shares(pushes.wrench(unit)) for unit in np.eye(3)]
        table = np.stack(columns, axis=-1)[pushes.pushing_n > 0.0] / self._planned
        return Agility(table)

    def _bounds(self, pushes: Pushes, direction: Floats) -> tuple[Floats, Floats]:
        """The bounds of s'' and of s' along a direction at each pose, both (K,)."""
        used = abs(pushes.shares(pushes.wrench(direction)))
        turning = abs(pushes.shares(pushes.turning_wrench())) * direction[2] ** 2
        worst_turning = turning.max(axis=1, initial=1e-12)
        cap_m_s = np.minimum(
            self._fastest_m_s(pushes, direction),
            np.sqrt(_TURNING_SHARE * self._planned / worst_turning),
        )
        dragged = abs(pushes.shares(pushes.dragging_wrench(direction, self.friction)))
        dragged = np.minimum(dragged, _DRAGGED_SHARE * self._planned)
        left = self._planned - dragged - turning * (cap_m_s**2)[:, None]
        bound_m_s2 = (left / np.maximum(used, 1e-9)).min(axis=1, initial=np.inf)
        bound_m_s2 = np.minimum(bound_m_s2, self._motor_bound(pushes, direction, used, cap_m_s))
        carried = (pushes.pushing_n > 0.0).any(axis=1)
        return np.maximum(np.where(carried, bound_m_s2, 0.0), _LEAST_M_S2), cap_m_s

    def _fastest_m_s(self, pushes: Pushes, direction: Floats) -> Floats:
        """The cap of s' by the wish of the caller, and by the motors, (K,)."""
        drives = self.drives
        no_load_m_s = drives.stall_n / drives.slope_n_s_per_m
        wire_m_s = drives.reference_limit_m_s * float(
            (drives.a_n_s_per_m / drives.b_n_s_per_m).max()
        )
        wheel_m_s = _FASTEST_SHARE * min(no_load_m_s, wire_m_s)
        per_speed = abs(self._speeds(pushes, direction)).max(axis=1, initial=1e-9)
        fastest: Floats = np.minimum(self.speed_m_s, wheel_m_s / per_speed)
        return fastest

    def _motor_bound(
        self, pushes: Pushes, direction: Floats, used: Floats, cap_m_s: Floats
    ) -> Floats:
        """The bound of s'' by what motors give at the greatest speed, rims included, (K,)."""
        per_speed = abs(self._speeds(pushes, direction))
        needed_n = used * pushes.pushing_n + self.drives.rim_mass_kg * per_speed
        given_n = self.drives.motor_limit_n(per_speed * cap_m_s[:, None])
        bound: Floats = (given_n / np.maximum(needed_n, 1e-9)).min(axis=1, initial=np.inf)
        return bound

    def _speeds(self, pushes: Pushes, direction: Floats) -> Floats:
        """Surface speed at each wheel per metre per second of path, (K, n)."""
        seen_m = self.layout.wheel_positions_m[pushes.wheels] - pushes.poses[:, None, :2]
        along = self.layout.wheel_directions[pushes.wheels]
        x, y, turn = direction.tolist()
        speeds: Floats = along[:, 0] * (x - turn * seen_m[..., 1]) + along[:, 1] * (
            y + turn * seen_m[..., 0]
        )
        return speeds


def _samples(path: Path) -> Iterator[tuple[Floats, Piece]]:
    """Path coordinates of the samples, part by part, each on one piece; ends belong to both."""
    for piece in path.pieces:
        steps = max(ceil((piece.end_s_m - piece.start_s_m) / _STEP_M), 2)
        samples_m = np.linspace(piece.start_s_m, piece.end_s_m, steps + 1)
        for part_m in by_parts(samples_m):
            yield part_m, piece
