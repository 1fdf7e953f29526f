"""`mdms demo`: the main job with no hardware."""

from argparse import Namespace
from math import degrees, hypot, pi
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdms_host.cli.console import say
from mdms_host.cli.exits import Exit
from mdms_host.cli.options import Verbs
from mdms_host.cli.scenario.inputs import open_program
from mdms_host.cli.simulation.compiling import WORTH_TELLING_S
from mdms_host.cli.simulation.simulate import simulate, verdict

if TYPE_CHECKING:
    from mdms_model.scenario.scenario import Goal, Parcel

SCENARIO = "array18"
NEAR_M = 0.010
NEAR_RAD = 3 * pi / 180


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("demo", help="18 cells carry and turn a parcel, with no hardware")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path("runs/demo"), help="run folder"
    )
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Run the prototype's array with its real firmware and tell how it went."""
    scenario = open_program(SCENARIO, ())
    columns, rows = scenario.array.columns, scenario.array.rows
    print(f"{columns} x {rows} cells with the real firmware on a virtual CAN bus:")
    finished, figures = simulate(scenario, "cpython", arguments.out)
    pairs = list(zip(scenario.parcel, figures["parcels"], strict=True))
    print(*(_journey(parcel, told) for parcel, told in pairs), sep="\n")
    print(*_machine(figures), sep="\n")
    print(f"  picture: {arguments.out / 'picture.png'}")
    ending = verdict(finished)
    if ending is Exit.OK and not all(_arrived(parcel, told) for parcel, told in pairs):
        say("mdms: not every parcel reached its goal in time")
        return Exit.TIME_LIMIT
    return ending


def _journey(parcel: "Parcel", told: dict[str, Any]) -> str:
    way_m = hypot(told["x_m"] - parcel.x_m, told["y_m"] - parcel.y_m)
    turn_deg = degrees(told["yaw_rad"] - parcel.yaw_rad)
    journey = f"  {parcel.name} moved {way_m:.3f} m and turned {turn_deg:+.1f} degrees"
    if parcel.goal is None:
        return journey
    miss_m, miss_rad = _miss(told, parcel.goal)
    miss = f"{1000 * miss_m:.1f} mm and {degrees(miss_rad):.2f} degrees"
    return f"{journey}; it stands {miss} off its goal"


def _arrived(parcel: "Parcel", told: dict[str, Any]) -> bool:
    if parcel.goal is None:
        return True
    miss_m, miss_rad = _miss(told, parcel.goal)
    return miss_m <= NEAR_M and miss_rad <= NEAR_RAD


def _miss(told: dict[str, Any], goal: "Goal") -> tuple[float, float]:
    """How far a parcel is from its goal [m, rad]."""
    turn_rad = (told["yaw_rad"] - goal.yaw_rad + pi) % (2 * pi) - pi
    return hypot(told["x_m"] - goal.x_m, told["y_m"] - goal.y_m), abs(turn_rad)


def _machine(figures: dict[str, Any]) -> list[str]:
    bus = figures["bus"]
    compiling = f" (after {figures['compile_s']:.0f} s of compiling, once per installation)"
    return [
        f"  bus: {bus['frames']:,} frames, {100 * bus['load']:.0f} % load at 1 Mbit/s",
        f"  {figures['duration_s']:g} s simulated in {figures['wall_s']:.1f} s: "
        f"{figures['real_time_factor']:.1f} times real time"
        f"{compiling if figures['compile_s'] >= WORTH_TELLING_S else ''}",
    ]
