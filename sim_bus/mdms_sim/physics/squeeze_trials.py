"""A parcel on the real array under one squeeze field after the other, from many poses.

Outcomes show where friction and gaps between wheels break a plan of squeezes. Each step is judged
by itself: from the yaw that the step before has left, against the yaw to which a field without gaps
and friction would have turned that.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.outline import outline_of, own_outline_m
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_model.squeeze import SqueezePlan
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


WITHIN_DEG = (2, 5, 10, 20)
#: A step has gone as predicted that ends this near.
AS_PREDICTED_RAD = np.radians(5.0)


class StepEnding(Enum):
    """How a step went."""

    AS_PREDICTED = "as predicted"
    STUCK = "came to rest elsewhere"
    WRONG_WAY = "turned the other way"
    MOVING = "not at rest in time"
    TIPPED = "tipped"
    NONE = "not begun"


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """Endings (N,) of one step's trials, and how far from the prediction [rad], NaN for none."""

    ending: tuple[StepEnding, ...]
    error_rad: Floats

    def count(self, ending: StepEnding) -> int:
        """How many ended so."""
        return self.ending.count(ending)


def step_outcomes(plan: SqueezePlan, trials: Trials) -> list[StepOutcome]:
    """The outcome of each step of a plan."""
    return [_outcome(plan, trials, step) for step in range(len(plan.steps))]


def final_error_rad(plan: SqueezePlan, trials: Trials) -> Floats:
    """How far each trial (N,) ended from the plan's yaw, up to its period; NaN: it did not end."""
    return _apart(trials.yaw_rad[:, -1] - plan.yaw_rad, plan.function.period_rad)


def share_within(error_rad: Floats, bound_rad: float) -> float:
    """Share of all trials, ended or not, that ended within a bound."""
    return float(np.mean(np.abs(error_rad) <= bound_rad)) if len(error_rad) else 0.0


def _outcome(plan: SqueezePlan, trials: Trials, step: int) -> StepOutcome:
    before, after = trials.yaw_rad[:, step], trials.yaw_rad[:, step + 1]
    begun, ended = ~np.isnan(before), ~np.isnan(after)
    predicted = np.full(len(before), np.nan)
    predicted[begun] = [plan.predict(yaw, step) for yaw in before[begun].tolist()]
    error = after - predicted
    endings = np.full(len(before), StepEnding.NONE, dtype=object)
    endings[begun] = StepEnding.TIPPED
    endings[ended & trials.rests[:, step]] = StepEnding.STUCK
    endings[ended & ~trials.rests[:, step]] = StepEnding.MOVING
    endings[ended & _against(predicted - before, after - before)] = StepEnding.WRONG_WAY
    period = plan.function.period_rad
    near = ended & (np.abs(_apart(np.where(ended, error, 0.0), period)) <= AS_PREDICTED_RAD)
    endings[near] = StepEnding.AS_PREDICTED
    return StepOutcome(tuple(endings), _apart(error, period))


def _against(wanted_rad: Floats, turned_rad: Floats) -> NDArray[np.bool_]:
    """Parcels that have turned to another angle than predicted, beyond a tolerance."""
    away = wanted_rad * turned_rad < 0.0
    return np.asarray(away & (np.abs(turned_rad) > AS_PREDICTED_RAD))


def _apart(error_rad: Floats, period_rad: float) -> Floats:
    return np.asarray((error_rad + period_rad / 2) % period_rad - period_rad / 2)
