"""`mdms map` and `mdms plan-squeeze`: fields and their effect on a parcel, drawn."""

import json
from argparse import Namespace
from dataclasses import replace
from math import degrees, isfinite, pi
from pathlib import Path
from typing import Any

import numpy as np

from mdms_array.checks import chosen_parcel
from mdms_array.host import references_m_s
from mdms_array.simulation import compiling_watched
from mdms_host.cli.console import progress, working
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.files import replacing
from mdms_host.cli.streams import say
from mdms_model.arrays import Floats
from mdms_model.outline import area_and_moment, outline_of, own_outline_m
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.motion import FIELDS
from mdms_model.scenario.scenario import Parcel, Scenario, ScenarioError
from mdms_model.squeeze import SqueezePlan, alike_turns, plan_squeezes, squeeze_function
from mdms_sim.physics.field_map import FieldMap, Law, map_field
from mdms_sim.physics.squeeze_trials import (
    WITHIN_DEG,
    StepEnding,
    Trials,
    final_error_rad,
    random_poses,
    share_within,
    step_outcomes,
    try_squeezes,
)
from mdms_sim.plots.canvas import MARK, form_of, save
from mdms_sim.plots.field_map import draw_field_map
from mdms_sim.plots.squeeze_plan import draw_squeeze_plan


def draw_map(arguments: Namespace) -> ExitCode:
    """Draw the map and print its equilibria and the path of the picture."""
    given = load_scenario(arguments.scenario, arguments.overrides)
    scenario = _with_field(given)
    parcel = chosen_parcel(scenario, arguments.parcel)
    path = arguments.out or Path(f"{Path(arguments.scenario).stem}-map.png")
    form_of(path)
    reference_m_s = references_m_s(scenario)
    with compiling_watched(), working(f"mapping the field on {parcel.name}"):
        field = map_field(scenario, parcel, reference_m_s, Law[arguments.law.upper()])
    with replacing(path, MARK.encode(), arguments.force) as partial:
        save(draw_field_map(scenario, parcel, field, reference_m_s), partial)
    if scenario is not given:
        say(
            f"mdms: motion.field is {given.motion.field!r}, which is no field to draw; {STAND_IN!r}"
            f" is drawn, and --set motion.field=NAME draws another: {', '.join(FIELDS)}"
        )
    figures = _map_figures(scenario, parcel, field)
    if arguments.json:
        print(json.dumps(figures | {"picture": str(path)}))
    else:
        print(*_map_report(figures), f"  picture: {path}", sep="\n")
    return ExitCode.OK


#: The field that is drawn of a scenario that has none.
STAND_IN = "inward"


def _with_field(scenario: Scenario) -> Scenario:
    """The scenario, with a field in place of goals or a program."""
    if scenario.motion.field not in ("goal", "program"):
        return scenario
    motion = replace(scenario.motion, field=STAND_IN, control="host", go_on=False)
    return replace(scenario, motion=motion)


def _map_figures(scenario: Scenario, parcel: Parcel, field: FieldMap) -> dict[str, Any]:
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


def _map_report(figures: dict[str, Any]) -> list[str]:
    lines = [f"{figures['title']}: {figures['field']} field on {figures['parcel']}"]
    free = sum(rest["kind"] == "neutral" for rest in figures["places"])
    if free:
        lines.append(f"  held along no or one direction at {free} places of the map")
    for rest in figures["places"]:
        if rest["kind"] == "neutral":
            continue
        stiffness = ", ".join(f"{value:.3g}" for value in rest["stiffness_n_per_m"])
        place = f"x {rest['x_m']:+z.4f} m, y {rest['y_m']:+z.4f} m"
        lines.append(f"  {rest['kind']} at {place}, stiffness {stiffness} N/m")
    for rest in figures["turns"]:
        kind = "stable" if rest["stable"] else "unstable"
        lines.append(f"  {kind} at yaw {rest['yaw_rad']:+z.4f} rad")
    return lines if len(lines) > 1 else [*lines, "  holds the parcel nowhere"]


#: Of the simulation; with steps of 1 ms one trial in sixty ended otherwise, and no share of angles.
STEP_S = 0.004
#: The relevant parts of a scenario are its table, its parcels and its speed.
ALONE = (
    *("run.fidelity=ideal", "motion.field=squeeze", "motion.part=[]"),
    *("motion.control=host", "motion.go_on=false", "belief={}", "fault=[]"),
)
#: A period above this is half a turn.
HALF_TURN_DEG = 179.9


def plan_squeeze(arguments: Namespace) -> ExitCode:
    """Plan, try the plan on the array, and print and draw the result."""
    scenario = load_scenario(arguments.scenario, [*arguments.overrides, *ALONE])
    if arguments.out is not None:
        form_of(arguments.out)
    parcel = _parcel(scenario, arguments)
    function = squeeze_function(own_outline_m(parcel))
    plan = plan_squeezes(function, arguments.yaw)
    trials = _try(scenario, parcel, plan, arguments) if arguments.poses else None
    figures = _figures(scenario, parcel, plan) | _tried(plan, trials)
    if arguments.out is not None:
        drawing = working(f"drawing {arguments.out}")
        with drawing, replacing(arguments.out, MARK.encode(), arguments.force) as partial:
            save(draw_squeeze_plan(scenario, parcel, plan, trials), partial)
        figures["picture"] = str(arguments.out)
    if arguments.json:
        print(json.dumps(figures))
    else:
        print(*_report(figures), sep="\n")
    widest_deg = max(WITHIN_DEG)
    if trials is not None and not figures["trials"]["within"][str(widest_deg)]:
        tried = figures["trials"]
        raise CommandError(
            f"in none of {tried['count']} trials the parcel came within {widest_deg} degrees of "
            f"its yaw, and {tried['count'] - tried['ended']} tipped or left the table; this table "
            "cannot turn it so: take another parcel or a finer table",
            ExitCode.FAILURE,
        )
    return ExitCode.OK


def _parcel(scenario: Scenario, arguments: Namespace) -> Parcel:
    """The scenario's parcel of that name, or its first, with other corners if there are any.

    Raises `CommandError` for one without corners, and `ScenarioError` for corners that make no
    convex polygon.
    """
    parcel = chosen_parcel(scenario, arguments.parcel)
    if arguments.corners is not None:
        return _polygon(parcel, np.array(arguments.corners))
    if parcel.shape == "disc":
        raise CommandError(
            f"parcel {parcel.name!r} is a disc, which no field turns; give a polygon with "
            "--corners, or another parcel with --parcel",
            ExitCode.USAGE,
        )
    return parcel


def _polygon(parcel: Parcel, corners_m: Floats) -> Parcel:
    """A uniform plate with these corners in place of a parcel, about the middle of their box."""
    corners_m = corners_m - (corners_m.min(axis=0) + corners_m.max(axis=0)) / 2
    length_m, width_m = (2 * corners_m.max(axis=0)).tolist()
    plate = replace(
        parcel,
        shape="polygon",
        corners_m=tuple((x_m, y_m) for x_m, y_m in corners_m.tolist()),
        length_m=length_m,
        width_m=width_m,
    )
    try:
        outline_of(plate)
    except ScenarioError as error:
        raise CommandError(f"--corners: {error}", ExitCode.USAGE) from None
    area_m2, moment_m3 = area_and_moment(corners_m)
    x_m, y_m = (moment_m3 / area_m2).tolist()
    return replace(plate, centre_of_mass_m=(x_m, y_m), inertia_kg_m2=None)


def _try(scenario: Scenario, parcel: Parcel, plan: SqueezePlan, arguments: Namespace) -> Trials:
    if scenario.motion.speed_m_s <= 0.0:
        raise CommandError(
            f"motion.speed_m_s is {scenario.motion.speed_m_s:g}, and nothing would move; give it a "
            "number above 0, as in --set motion.speed_m_s=0.05, or plan alone with --poses 0",
            ExitCode.USAGE,
        )
    seed = scenario.run.seed if arguments.seed is None else arguments.seed
    poses = random_poses(scenario, parcel, arguments.poses, seed)
    if not len(poses):
        raise CommandError(
            f"parcel {parcel.name!r} tips wherever it lies on this array; give a larger one, or "
            "plan alone with --poses 0",
            ExitCode.USAGE,
        )
    plan_squeeze = replace(scenario.run, step_s=STEP_S)
    alone = replace(scenario, parcel=(parcel,), run=plan_squeeze)
    fields = [_field_m_s(alone, step.heading_rad) for step in plan.steps]
    with compiling_watched(), progress("squeezes") as advance:
        return try_squeezes(alone, parcel, fields, poses, arguments.time, progress=advance)


def _field_m_s(scenario: Scenario, heading_rad: float) -> Floats:
    motion = replace(scenario.motion, heading_rad=heading_rad)
    return references_m_s(replace(scenario, motion=motion))


def _figures(scenario: Scenario, parcel: Parcel, plan: SqueezePlan) -> dict[str, Any]:
    function = plan.function
    return {
        "title": scenario.title,
        "parcel": parcel.name,
        "corners_m": own_outline_m(parcel).tolist(),
        "period_rad": function.period_rad,
        "alike_in_a_turn": alike_turns(own_outline_m(parcel)),
        "stable_rad": list(function.stable_rad),
        "unstable_rad": list(function.unstable_rad),
        "yaw_rad": plan.yaw_rad,
        "margin_rad": plan.margin_rad if isfinite(plan.margin_rad) else None,
        "steps": [
            {
                "heading_rad": step.heading_rad,
                "margin_rad": step.margin_rad if isfinite(step.margin_rad) else None,
                "yaws_rad": list(step.yaws_rad),
            }
            for step in plan.steps
        ],
    }


def _tried(plan: SqueezePlan, trials: Trials | None) -> dict[str, Any]:
    if trials is None:
        return {"trials": None}
    error_rad = final_error_rad(plan, trials)
    steps = [
        {ending.name.lower(): outcome.count(ending) for ending in StepEnding}
        | {"within": _within(outcome.error_rad)}
        for outcome in step_outcomes(plan, trials)
    ]
    return {
        "trials": {
            "count": len(error_rad),
            "ended": int(np.count_nonzero(~np.isnan(error_rad))),
            "within": _within(error_rad),
            "steps": steps,
        }
    }


def _within(error_rad: Floats) -> dict[str, float]:
    """Shares of all trials by the bound, in degrees."""
    return {str(bound): share_within(error_rad, bound * pi / 180) for bound in WITHIN_DEG}


def _report(figures: dict[str, Any]) -> list[str]:
    steps, period_deg = figures["steps"], degrees(figures["period_rad"])
    count = f"{len(steps)} squeeze{'s' * (len(steps) > 1)}"
    yaw = f"yaw {degrees(figures['yaw_rad']):.1f}°"
    lines = [f"{figures['title']}: {figures['parcel']} from any angle to {yaw} in {count}"]
    lines.append(f"  {_symmetry(figures['alike_in_a_turn'], period_deg)}")
    for number, step in enumerate(steps, start=1):
        yaws = " or ".join(f"{degrees(yaw):.1f}°" for yaw in step["yaws_rad"])
        margin = step["margin_rad"]
        spare = "" if margin is None else f", {degrees(margin):.1f}° to spare"
        heading = f"{degrees(step['heading_rad']):.1f}°"
        lines.append(f"  {number}. onto a line along {heading:>6}: yaw {yaws}{spare}")
    if figures["trials"] is not None:
        lines += _trial_lines(figures["trials"])
    if "picture" in figures:
        lines.append(f"  picture: {figures['picture']}")
    return lines


def _symmetry(alike: int, period_deg: float) -> str:
    """Up to what angles are known at all, and why."""
    text = f"yaws are known up to {period_deg:.4g}°: a squeeze field is the same after half a turn"
    if period_deg > HALF_TURN_DEG:
        return text
    if alike > 1:
        return f"{text}, and the polygon looks the same {alike} times in a turn"
    return f"{text}, and turns the polygon alike {round(180 / period_deg)} times in that"


def _trial_lines(trials: dict[str, Any]) -> list[str]:
    def shares(within: dict[str, float]) -> str:
        return ", ".join(f"{share:.0%} within {bound}°" for bound, share in within.items())

    lines = [f"  simulated from {trials['count']} random poses: {shares(trials['within'])}"]
    for number, step in enumerate(trials["steps"], start=1):
        endings = [
            f"{step[ending.name.lower()]} {ending.value}"
            for ending in StepEnding
            if step[ending.name.lower()]
        ]
        lines.append(f"    step {number}, beside the field without gaps: {', '.join(endings)}")
    return lines
