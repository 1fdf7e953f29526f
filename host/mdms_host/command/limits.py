"""`mdms limits`: the paper's bounds on reference speeds, for each parcel."""

import json
from argparse import Namespace
from dataclasses import asdict
from typing import Any

from mdms_host.command.exits import Exit
from mdms_host.command.inputs import open_scenario, refusing_bad_scenarios
from mdms_host.command.options import Verbs, add_json, add_scenario

#: Name in JSON, what people are told, unit.
ROWS = (
    ("supports_min", "supports, at least", ""),
    ("supports_max", "supports, at most", ""),
    ("normal_min_n", "normal force, at least (eq 2)", "N"),
    ("normal_max_n", "normal force, at most (eq 3)", "N"),
    ("rolling_max_m_s", "reference: all wheels roll below (eq 14)", "m/s"),
    ("sliding_min_m_s", "reference: all slide at equilibrium above (eq 15)", "m/s"),
    ("rolling_equilibrium_max_m_s", "reference: all roll at equilibrium below (eq 17)", "m/s"),
    ("droop", "speed of a free wheel over its reference (a/b)", ""),
)


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("limits", help="the paper's bounds for each parcel")
    add_scenario(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Print the bounds."""
    scenario = open_scenario(arguments.scenario, arguments.overrides)
    from mdms_sim.physics.limits import parcel_limits

    with refusing_bad_scenarios():
        bounds = [asdict(parcel_limits(scenario, parcel)) for parcel in scenario.parcel]
    if arguments.json:
        print(json.dumps({"parcels": bounds}))
    else:
        print("\n\n".join(_table(scenario.title, parcel) for parcel in bounds))
    return Exit.OK


def _table(title: str, parcel: dict[str, Any]) -> str:
    width = max(len(text) for _name, text, _unit in ROWS)
    lines = [f"{title}: {parcel['name']}"]
    lines += [
        f"  {text:{width}}  {parcel[name]:>9.4g} {unit}".rstrip() for name, text, unit in ROWS
    ]
    return "\n".join(lines)
