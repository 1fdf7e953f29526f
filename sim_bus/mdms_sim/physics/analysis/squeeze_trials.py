"""A parcel on the real array under one squeeze field after the other, from many poses."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.outline import outline_of, own_outline_m
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_model.statics.support_margin import support_margin_m
from mdms_sim.physics.plane.handling import lift, set_down
from mdms_sim.physics.plane.ideal import run_ideal
from mdms_sim.physics.plane.world import World

#: A parcel rests that has moved and turned less than this in a look.
LOOK_S = 0.5
REST_M, REST_RAD = 1e-5, 1e-4
#: Poses in which it would tip at once are drawn again: at first so often, then for each so often.
FIRST_DRAWS, MOST_DRAWS = 500, 20


@dataclass(frozen=True, slots=True)
class Trials:
    """Poses (N, steps + 1, 3) [m, m, rad; table frame] at first and after each step.

    They are NaN after a step in which the parcel tipped, or left the table. `rests` (N, steps) says
    where it came to rest before the time was over.
    """

    pose: Floats
    rests: NDArray[np.bool_]

    @property
    def yaw_rad(self) -> Floats:
        """Yaws (N, steps + 1), NaN where there is none any more."""
        return self.pose[..., 2]


def random_poses(scenario: Scenario, parcel: Parcel, count: int, seed: int) -> Floats:
    """Poses (count, 3) anywhere over the table with any yaw, in which the parcel stands.

    Along a side on which the table is too short for it the parcel lies in the middle. Where no pose
    is found in which it stands, there are fewer.
    """
    random = np.random.default_rng(seed)
    wheel_m, outline = build_wheels(scenario).position_m, outline_of(parcel)
    corners_m, array = own_outline_m(parcel), scenario.array
    half_m = np.array([array.columns, array.rows]) * array.pitch_m / 2
    poses: list[tuple[float, float, float]] = []
    for _ in range(FIRST_DRAWS + count * MOST_DRAWS):
        if len(poses) == count:
            break
        yaw_rad = random.uniform(0.0, 2 * np.pi)
        turn = np.array([[np.cos(yaw_rad), np.sin(yaw_rad)], [-np.sin(yaw_rad), np.cos(yaw_rad)]])
        turned_m = corners_m @ turn
        low_m, high_m = -half_m - turned_m.min(axis=0), half_m - turned_m.max(axis=0)
        middle_m, reach_m = (low_m + high_m) / 2, np.maximum(high_m - low_m, 0.0) / 2
        place_m = middle_m + random.uniform(-1.0, 1.0, 2) * reach_m
        pose = (float(place_m[0]), float(place_m[1]), float(yaw_rad))
        if support_margin_m(wheel_m, outline, parcel.centre_of_mass_m, pose) > 0.0:
            poses.append(pose)
    return np.array(poses).reshape(-1, 3)


def try_squeezes(
    scenario: Scenario,
    parcel: Parcel,
    references_m_s: list[Floats],
    poses: Floats,
    limit_s: float,
    *,
    progress: Callable[[float], object] = lambda share: None,
) -> Trials:
    """Put the parcel at each pose and run each step's references until it rests, or `limit_s`."""
    world = World(replace(scenario, parcel=(parcel,), fault=()))
    fresh = world.state()
    found = np.full((len(poses), len(references_m_s) + 1, 3), np.nan)
    rests = np.zeros((len(poses), len(references_m_s)), dtype=np.bool_)
    for trial, pose in enumerate(poses):
        world.restore(fresh)
        lift(world.scene, 0)
        set_down(world.scene, 0, *pose)
        found[trial, 0] = pose
        for step, reference_m_s in enumerate(references_m_s):
            rests[trial, step] = _settle(world, reference_m_s, limit_s)
            if _has_tipped(world):
                break
            found[trial, step + 1] = world.pose[0]
        progress((trial + 1) / len(poses))
    return Trials(found, rests)


def _settle(world: World, reference_m_s: Floats, limit_s: float) -> bool:
    """Whether the parcel comes to rest under these references before the time is over."""
    step_s = world.scenario.run.step_s
    steps = max(1, round(LOOK_S / step_s))
    for _ in range(max(1, round(limit_s / LOOK_S))):
        before = world.pose[0]
        run_ideal(world, reference_m_s, step_s, steps, steps)
        if _has_tipped(world):
            return False
        moved = abs(world.pose[0] - before)
        if moved[:2].max() < REST_M and moved[2] < REST_RAD:
            return True
    return False


def _has_tipped(world: World) -> bool:
    return any(event.kind == "tip" for event in world.events)
