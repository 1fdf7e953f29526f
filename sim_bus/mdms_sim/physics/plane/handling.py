"""Parcels handled from outside: pushed, lifted, set down; brought from a stock, taken away."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from random import Random
from typing import Any

import numpy as np

from mdms_model.array import build_wheels, last_support_m
from mdms_model.arrays import Floats, Ints
from mdms_model.outline import gap_m, outline_of, own_outline_m, placed_m
from mdms_model.parcel import turned
from mdms_model.run.record import Event, leaving
from mdms_model.scenario.scenario import Parcel, Scenario, Stream
from mdms_sim.physics.plane.records import STANDS, Scene


def push(scene: Scene, p: int, impulse_n_s: tuple[float, float], twist_nms: float) -> bool:
    """Give parcel p an impulse through its centre of mass, and one about it [table frame].

    Returns False, and does nothing, while it is lifted.
    """
    now, body = scene.state.parcels[p], scene.model.parcels[p]
    if now.lifted:
        return False
    now.vx_m_s += impulse_n_s[0] / body.mass_kg
    now.vy_m_s += impulse_n_s[1] / body.mass_kg
    now.yaw_rate_rad_s += twist_nms / body.inertia_kg_m2
    return True


def lift(scene: Scene, p: int) -> None:
    """Take parcel p off the table: it stands still there, touches nothing and covers no sensor.

    A tipped parcel is upright in the hand.
    """
    now = scene.state.parcels[p]
    now.lifted += 1
    now.tipped = STANDS
    now.vx_m_s = now.vy_m_s = now.yaw_rate_rad_s = 0.0


def set_down(
    scene: Scene, p: int, x_m: float | None, y_m: float | None, yaw_rad: float | None
) -> bool:
    """Put parcel p at rest where its origin is to be, None: where it was [table frame].

    Returns False while other hands still hold it.
    """
    now, body = scene.state.parcels[p], scene.model.parcels[p]
    arm_x, arm_y = turned(body.centre_x_m, body.centre_y_m, now.yaw_rad)
    x_m = now.x_m - arm_x if x_m is None else x_m
    y_m = now.y_m - arm_y if y_m is None else y_m
    now.yaw_rad = now.yaw_rad if yaw_rad is None else yaw_rad
    arm_x, arm_y = turned(body.centre_x_m, body.centre_y_m, now.yaw_rad)
    now.x_m, now.y_m = x_m + arm_x, y_m + arm_y
    now.lifted -= 1
    return bool(now.lifted == 0)


def take_away(scene: Scene, p: int) -> None:
    """Parcel p leaves: what carries on behind an exit has it, and it does not tip."""
    lift(scene, p)
    now = scene.state.parcels[p]
    now.away = 1
    carried = scene.scratch.wheels["parcel"] == p
    for name in ("contact", "normal_n", "force_n", "slip_m_s"):
        scene.state.wheels[name][carried] = 0


def bring(scene: Scene, p: int, pose: tuple[float, float, float]) -> None:
    """Parcel p, which is away, comes: at rest where its origin is to be [table frame]."""
    set_down(scene, p, *pose)
    scene.state.parcels[p].away = 0


#: Whether a place is free is looked at so often [s].
_LOOK_S = 0.01
_ROUNDING_S = 1e-9
#: What no support holds at an edge is so near to the last of them, or beyond it [m].
_EDGE_M = 0.01


@dataclass(frozen=True, slots=True)
class StreamsState:
    """The state that streams go on from:

    random numbers, how many came, when the next is due, and which.
    """

    streams: tuple[tuple[Any, int, float, int | None], ...]


class Streams:
    """The streams and exits of a scenario."""

    def __init__(self, scenario: Scenario) -> None:
        self._parcels = scenario.parcel
        self._radii_m = [outline_of(parcel).radius_m for parcel in scenario.parcel]
        self._own_m = [own_outline_m(parcel) for parcel in scenario.parcel]
        wheels_m = build_wheels(scenario).position_m
        self._exits = [(each, last_support_m(wheels_m, each.side)) for each in scenario.exit]
        numbers = {parcel.name: number for number, parcel in enumerate(scenario.parcel)}
        self._streams = [
            _Stream(stream, [numbers[name] for name in stream.parcels], f"{scenario.run.seed}/{i}")
            for i, stream in enumerate(scenario.stream)
        ]

    def state(self) -> StreamsState:
        """The state that the next parcels depend on."""
        return StreamsState(
            tuple((one.random.getstate(), one.count, one.due_s, one.next) for one in self._streams)
        )

    def restore(self, state: StreamsState) -> None:
        """Go on from there."""
        for one, (chance, count, due_s, next_) in zip(self._streams, state.streams, strict=True):
            one.random.setstate(chance)
            one.count, one.due_s, one.next = count, due_s, next_

    def due(self, now_s: float) -> bool:
        """Whether a stream may have something to bring."""
        return any(now_s >= one.due_s - _ROUNDING_S for one in self._streams)

    def bring(self, scene: Scene, now_s: float, poses: Floats) -> Iterator[Event]:
        """Set down the next parcel of each stream that is due, where its place is free."""
        for stream in self._streams:
            if now_s < stream.due_s - _ROUNDING_S:
                continue
            stream.due_s = now_s + _LOOK_S
            number = stream.next = stream.draw(self._parcels, scene.state.parcels["away"])
            if number is None or not self._is_free(stream.plan, number, poses):
                continue
            pose = stream.place()
            bring(scene, number, pose)
            poses[number] = pose
            stream.next = None
            stream.count += 1
            stream.due_s = inf if stream.count == stream.plan.most else now_s + stream.period_s
            where = f"x {pose[0]:.4f} m, y {pose[1]:.4f} m, yaw {pose[2]:.4f} rad"
            parcel = self._parcels[number].name
            yield Event(now_s, "arrival", f"set down at {where}", parcel=parcel)

    def take(self, scene: Scene, number: int, now_s: float) -> Event | None:
        """The event of a parcel that no support holds, if an exit takes it; it is away then."""
        now, parcel = scene.state.parcels[number], self._parcels[number]
        outs = ((each.out_m(now.x_m, now.y_m, last_m), each) for each, last_m in self._exits)
        out_m, taker = max(outs, key=lambda pair: pair[0], default=(-inf, None))
        if taker is None or out_m < -_EDGE_M:
            return None
        take_away(scene, number)
        wrong = bool(taker.kinds) and parcel.kind not in taker.kinds
        return leaving(now_s, parcel.name, taker.name, wrong)

    def _is_free(self, plan: Stream, number: int, poses: Floats) -> bool:
        """Whether a parcel can be set down, wherever about its place it turns out to be put."""
        place, radius_m = np.array([plan.x_m, plan.y_m, plan.yaw_rad]), self._radii_m[number]
        clear_m = plan.clear_m + plan.spread_m + plan.spread_rad * radius_m
        mine_m = placed_m(self._own_m[number], place)
        for other in np.flatnonzero(np.isfinite(poses[:, 0])).tolist():
            reach_m = radius_m + self._radii_m[other] + clear_m
            if np.hypot(*(poses[other] - place)[:2]) > reach_m:
                continue
            if gap_m(mine_m, placed_m(self._own_m[other], poses[other])) < clear_m:
                return False
        return True


class _Stream:
    """One stream, and how far it has come."""

    def __init__(self, plan: Stream, stock: list[int], seed: str) -> None:
        self.plan = plan
        self.stock = stock
        self.random = Random(f"{seed}/stream")
        self.count = 0
        #: The next parcel, if it is drawn already.
        self.next: int | None = None
        self.due_s = plan.start_s
        self.period_s = max(plan.period_s, _LOOK_S)

    def draw(self, parcels: tuple[Parcel, ...], away: Ints) -> int | None:
        """What comes next: the first one in stock of a kind by chance; None while there is none."""
        if self.next is not None:
            return self.next
        firsts: dict[str, int] = {}
        for number in self.stock:
            if away[number]:
                firsts.setdefault(parcels[number].kind or parcels[number].name, number)
        return self.random.choice(list(firsts.values())) if firsts else None

    def place(self) -> tuple[float, float, float]:
        """Where it is set down this time."""
        spread = (self.plan.spread_m, self.plan.spread_m, self.plan.spread_rad)
        x_m, y_m, yaw_rad = (self.random.uniform(-most, most) for most in spread)
        return self.plan.x_m + x_m, self.plan.y_m + y_m, self.plan.yaw_rad + yaw_rad
