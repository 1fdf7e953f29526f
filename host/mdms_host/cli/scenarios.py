"""`mdms scenarios` and `mdms limits`: knowledge about scenarios before they run."""

import json
from argparse import Namespace
from dataclasses import asdict
from typing import Any

from mdms_array.checks import MASSLESS, gain_limits, refuse_tipping
from mdms_array.extras import COMPILER
from mdms_array.host import command_figures
from mdms_host.cli.console import working
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.streams import say
from mdms_model.fields import command_of
from mdms_model.scenario.file import builtin_names, builtin_text, load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_model.statics.limits import is_paper_row, parcel_limits

#: Name in JSON, in words, unit.
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
GAIN = "gain: 45 degrees of phase margin up to"
WIDTH = max(len(text) for _name, text, _unit in ROWS)


def scenarios(arguments: Namespace) -> ExitCode:
    """Print the built-in scenarios, a name and a title each, or one of them to start from."""
    if arguments.show is not None:
        text = builtin_text(arguments.show)
        print(
            json.dumps({"name": arguments.show, "toml": text}) if arguments.json else text.rstrip()
        )
        return ExitCode.OK
    titles = {name: load_scenario(name).title for name in builtin_names()}
    if arguments.json:
        print(json.dumps({"scenarios": [{"name": n, "title": t} for n, t in titles.items()]}))
    else:
        width = max(map(len, titles), default=0)
        for name, title in titles.items():
            print(f"{name:{width}}  {title}")
    return ExitCode.OK


def limits(arguments: Namespace) -> ExitCode:
    """Print the paper's bounds for each parcel, the field's references, and the largest gain.

    Raises `InputError` for a parcel that no run takes.
    """
    scenario = load_scenario(arguments.scenario, arguments.overrides)
    refuse_tipping(scenario)
    if COMPILER.missing and not all(is_paper_row(scenario, each) for each in scenario.parcel):
        say(f"mdms: without numba this takes minutes; pip install {COMPILER.requirement}")
    with working(f"bounds of {', '.join(parcel.name for parcel in scenario.parcel)}"):
        bounds = [asdict(parcel_limits(scenario, parcel)) for parcel in scenario.parcel]
    gain, field = gain_limits(scenario.cell), _field(scenario)
    if arguments.json:
        print(json.dumps({"parcels": bounds} | gain | field))
    else:
        tables = [_table(scenario.title, parcel) for parcel in bounds]
        print(*tables, *map(_field_rows, field.values()), _gain_row(gain), sep="\n\n")
    return ExitCode.OK


def _field(scenario: Scenario) -> dict[str, Any]:
    """The references of a field, under `motion`; nothing where parcels are steered to goals."""
    if scenario.motion.field in ("goal", "program"):
        return {}
    return {"motion": command_figures(scenario, command_of(scenario))}


def _field_rows(field: dict[str, Any]) -> str:
    text = f"references of the field {field['field']!r}"
    rows = [f"  {text:{WIDTH}}  {field['fastest_m_s']:>9.4g} m/s"]
    if field["slowest_m_s"] != field["fastest_m_s"]:
        rows.append(f"  {'the least that is not 0':{WIDTH}}  {field['slowest_m_s']:>9.4g} m/s")
    if field["policy"]:
        rolling = field["policy"] == "rolling"
        text = f"policy {field['policy']!r}, at {'most' if rolling else 'least'} (parcel "
        text += f"{field['limited_by']!r})"
        rows.append(f"  {text:{WIDTH}}  {field['limit_m_s']:>9.4g} m/s")
        made = {"clamp": ", clamped", "refuse": ", refused", None: ""}[field["outside"]]
        text = f"wheels outside it{made}"
        rows.append(f"  {text:{WIDTH}}  {field['wheels_outside']:>9} of {field['wheels']}")
    return "\n".join(rows)


def _table(title: str, parcel: dict[str, Any]) -> str:
    lines = [f"{title}: {parcel['name']}"]
    lines += [
        f"  {text:{WIDTH}}  {parcel[name]:>9.4g} {unit}".rstrip() for name, text, unit in ROWS
    ]
    return "\n".join(lines)


def _gain_row(gain: dict[str, float | None]) -> str:
    largest = gain["gain_max_vs_per_m"]
    value = MASSLESS if largest is None else f"{largest:>9.4g} V s/m"
    margin_deg = gain["phase_margin_deg"]
    has = "" if margin_deg is None else f" ({gain['gain_vs_per_m']:g} has {margin_deg:.0f})"
    return f"  {GAIN:{WIDTH}}  {value}{has}"
