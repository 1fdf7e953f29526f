"""The references of a scenario's field: within its policy, or said to be outside."""

from typing import Any

from mdms_host.cli.streams import say
from mdms_model.arrays import Floats
from mdms_model.fields.command import Command, accepted
from mdms_model.scenario.scenario import Scenario


def references_m_s(scenario: Scenario) -> Floats:
    """References of all wheels [m/s], shape (W,); what its policy clamps is said on stderr.

    Raises FieldError, PolicyError and `ScenarioError`.
    """
    command = accepted(scenario)
    if command.outside:
        say(f"mdms: {command}; clamped")
    return command.set_m_s


def command_figures(scenario: Scenario, command: Command) -> dict[str, Any]:
    """What a field asks of the wheels and what its policy makes of that, for JSON."""
    speeds_m_s = abs(command.asked_m_s)
    moving_m_s = speeds_m_s[speeds_m_s > 0.0]
    return {
        "field": scenario.motion.field,
        "slowest_m_s": float(moving_m_s.min(initial=speeds_m_s.max())),
        "fastest_m_s": float(speeds_m_s.max()),
        "policy": scenario.motion.policy,
        "limit_m_s": None if command.bound is None else command.bound.limit_m_s,
        "limited_by": None if command.bound is None else command.bound.parcel,
        "wheels": len(speeds_m_s),
        "wheels_outside": command.outside,
        "outside": scenario.motion.outside if command.outside else None,
    }
