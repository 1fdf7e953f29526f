"""`mdms demo`: the main job with no hardware."""

import json
from argparse import Namespace
from collections.abc import Mapping
from math import degrees, hypot
from pathlib import Path
from typing import Any

from mdms_array.extras import PAGE, require
from mdms_array.figures import REPORTED_S
from mdms_array.source import open_program
from mdms_host.cli.exits import Exit
from mdms_host.cli.simulation.simulate import simulate, verdict
from mdms_model.scenario.scenario import Parcel, Scenario


def run(arguments: Namespace) -> Exit:
    """Run the prototype's array with its real firmware and report how it went; or with its page."""
    scenario, main = open_program(arguments.scenario, ["run.fidelity=firmware"])
    if arguments.page is not None:
        require(PAGE, "mdms demo --page")
        # The page is an extra.
        from mdms_host.cli.simulation.live import show  # noqa: PLC0415

        return show(scenario, arguments, main)
    columns, rows = scenario.array.columns, scenario.array.rows
    if not arguments.json:
        print(f"{columns} x {rows} cells with the real firmware on a virtual CAN bus:")
    ended = simulate(scenario, "cpython", arguments.out, main=main)
    if arguments.json:
        print(json.dumps(ended.figures))
    else:
        _report(scenario, ended.figures, arguments.out)
    return verdict(ended)


def _report(scenario: Scenario, figures: Mapping[str, Any], folder: Path) -> None:
    pairs = list(zip(scenario.parcel, figures["parcels"], strict=True))
    goals = {goal["parcel"]: goal for goal in figures["goals"]}
    print(*(_journey(parcel, end, goals) for parcel, end in pairs), sep="\n")
    print(*_machine(figures), sep="\n")
    print(f"  picture: {folder / 'picture.png'}")


def _journey(parcel: Parcel, end: dict[str, Any], goals: dict[str, dict[str, Any]]) -> str:
    way_m = hypot(end["x_m"] - parcel.x_m, end["y_m"] - parcel.y_m)
    turn_deg = degrees(end["yaw_rad"] - parcel.yaw_rad)
    journey = f"  {parcel.name} moved {way_m:.3f} m and turned {turn_deg:+.1f} degrees"
    if parcel.name not in goals:
        return journey
    miss_m, miss_rad = (goals[parcel.name][name] for name in ("position_error_m", "yaw_error_rad"))
    miss = f"{1000 * miss_m:.1f} mm and {degrees(abs(miss_rad)):.2f} degrees"
    return f"{journey}; it stands {miss} off its goal"


def _machine(figures: Mapping[str, Any]) -> list[str]:
    bus = figures["bus"]
    compiling = f" (after {figures['compile_s']:.0f} s of compiling)"
    return [
        f"  bus: {bus['frames']:,} frames, {100 * bus['load']:.0f} % load at 1 Mbit/s",
        f"  {figures['duration_s']:g} s simulated in {figures['wall_s']:.1f} s: "
        f"{figures['real_time_factor']:.1f} times real time"
        f"{compiling if figures['compile_s'] >= REPORTED_S else ''}",
    ]
