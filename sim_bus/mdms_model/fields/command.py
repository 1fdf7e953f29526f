"""The references of the wheels under a scenario's field, with its droop and its policy."""

from dataclasses import dataclass

import numpy as np

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.fields.policy import Bound, PolicyError, bound_of
from mdms_model.fields.references import references_m_s
from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Scenario


@dataclass(frozen=True, slots=True)
class Command:
    """References (W,) [m/s] as the field has them, and as they are set by its policy, if any.

    `outside` counts the wheels whose reference from the field breaks the policy.
    """

    asked_m_s: Floats
    set_m_s: Floats
    bound: Bound | None = None
    outside: int = 0

    def __str__(self) -> str:
        """The references outside the policy, and their limit; empty if there are none."""
        if self.bound is None or not self.outside:
            return ""
        outside_m_s = abs(self.asked_m_s[self.bound.outside(self.asked_m_s)])
        rolling = self.bound.policy == "rolling"
        extreme = f"up to {outside_m_s.max():.4g}" if rolling else f"only {outside_m_s.min():.4g}"
        return (
            f"motion.policy is {self.bound.policy!r}, but {self.outside} of {len(self.asked_m_s)} "
            f"wheels have references of {extreme} m/s; {self.bound}"
        )


def command_of(scenario: Scenario) -> Command:
    """The references of a scenario's field, within its policy or not.

    References make surfaces of free wheels run at (a/b) r; where droop is compensated, r = (b/a) v
    makes them run at the field's v. Raises FieldError, PolicyError where the policy allows nothing,
    and `ScenarioError`.
    """
    motion, wheels = scenario.motion, build_wheels(scenario)
    asked_m_s = references_m_s(motion, wheels)
    if motion.compensate_droop:
        asked_m_s = asked_m_s / drive_of(scenario.cell).droop
    bound = bound_of(scenario)
    if bound is None:
        return Command(asked_m_s, asked_m_s)
    outside = int(np.count_nonzero(bound.outside(asked_m_s)))
    return Command(asked_m_s, bound.clamp(asked_m_s, wheels.cell), bound, outside)


def accepted(scenario: Scenario) -> Command:
    """The command of a scenario; raises PolicyError for one outside a policy that refuses."""
    command = command_of(scenario)
    if command.outside and scenario.motion.outside == "refuse":
        lower = "lower" if scenario.motion.policy == "rolling" else "raise"
        raise PolicyError(
            f"{command}; {lower} the field's speeds, or set motion.outside to 'clamp'"
        )
    return command
