"""Where friction and gaps between wheels break a plan of squeezes, step by step.

Each step is judged by itself: from the yaw that the step before has left, against the yaw to which
a field without gaps and friction would have turned that.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.squeeze.plan import SqueezePlan
from mdms_sim.physics.analysis.squeeze_trials import Trials

WITHIN_DEG = (2, 5, 10, 20)
#: A step has gone as predicted that ends this near.
AS_PREDICTED_RAD = np.radians(5.0)


class Ending(Enum):
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

    ending: tuple[Ending, ...]
    error_rad: Floats

    def count(self, ending: Ending) -> int:
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
    endings = np.full(len(before), Ending.NONE, dtype=object)
    endings[begun] = Ending.TIPPED
    endings[ended & trials.rests[:, step]] = Ending.STUCK
    endings[ended & ~trials.rests[:, step]] = Ending.MOVING
    endings[ended & _against(predicted - before, after - before)] = Ending.WRONG_WAY
    period = plan.function.period_rad
    near = ended & (np.abs(_apart(np.where(ended, error, 0.0), period)) <= AS_PREDICTED_RAD)
    endings[near] = Ending.AS_PREDICTED
    return StepOutcome(tuple(endings), _apart(error, period))


def _against(wanted_rad: Floats, turned_rad: Floats) -> NDArray[np.bool_]:
    """Who has turned away from where it was to turn, by more than is taken for as predicted."""
    away = wanted_rad * turned_rad < 0.0
    return np.asarray(away & (np.abs(turned_rad) > AS_PREDICTED_RAD))


def _apart(error_rad: Floats, period_rad: float) -> Floats:
    return np.asarray((error_rad + period_rad / 2) % period_rad - period_rad / 2)
