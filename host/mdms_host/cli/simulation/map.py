"""`mdms map`: what a field does to a parcel, wherever it lies."""

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

from mdms_array.checks import chosen_parcel
from mdms_array.compiling import compiling_watched
from mdms_array.host import references_m_s
from mdms_host.cli.exits import Exit
from mdms_host.cli.files import replacing
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_sim.physics.analysis.field_map import FieldMap, Law, map_field
from mdms_sim.plots.canvas import MARK, form_of, save
from mdms_sim.plots.field_map import draw_field_map


def run(arguments: Namespace) -> Exit:
    """Draw the map and print its equilibria and the path of the picture."""
    scenario = load_scenario(arguments.scenario, arguments.overrides)
    parcel = chosen_parcel(scenario, arguments.parcel)
    path = arguments.out or Path(f"{Path(arguments.scenario).stem}-map.png")
    form_of(path)
    reference_m_s = references_m_s(scenario)
    with compiling_watched():
        field = map_field(scenario, parcel, reference_m_s, Law[arguments.law.upper()])
    with replacing(path, MARK.encode(), arguments.force) as partial:
        save(draw_field_map(scenario, parcel, field, reference_m_s), partial)
    figures = _figures(scenario, parcel, field)
    if arguments.json:
        print(json.dumps(figures | {"picture": str(path)}))
    else:
        print(*_report(figures), f"  picture: {path}", sep="\n")
    return Exit.OK


def _figures(scenario: Scenario, parcel: Parcel, field: FieldMap) -> dict[str, Any]:
    return {
        "title": scenario.title,
        "field": scenario.motion.field,
        "law": field.law.name.lower(),
        "parcel": parcel.name,
        "places": [
            {
                "x_m": rest.x_m,
                "y_m": rest.y_m,
                "kind": rest.kind.value,
                "stiffness_n_per_m": [value.real for value in rest.stiffness_n_per_m],
                "curl_n_per_m": [value.imag for value in rest.stiffness_n_per_m],
            }
            for rest in field.places
        ],
        "turns": [{"yaw_rad": rest.yaw_rad, "stable": rest.stable} for rest in field.turns],
    }


def _report(figures: dict[str, Any]) -> list[str]:
    lines = [f"{figures['title']}: {figures['field']} field on {figures['parcel']}"]
    free = sum(rest["kind"] == "neutral" for rest in figures["places"])
    if free:
        lines.append(f"  held along no or one direction at {free} places of the map")
    for rest in figures["places"]:
        if rest["kind"] == "neutral":
            continue
        stiffness = ", ".join(f"{value:.3g}" for value in rest["stiffness_n_per_m"])
        place = f"x {rest['x_m']:+.4f} m, y {rest['y_m']:+.4f} m"
        lines.append(f"  {rest['kind']} at {place}, stiffness {stiffness} N/m")
    for rest in figures["turns"]:
        kind = "stable" if rest["stable"] else "unstable"
        lines.append(f"  {kind} at yaw {rest['yaw_rad']:+.4f} rad")
    return lines if len(lines) > 1 else [*lines, "  holds the parcel nowhere"]
