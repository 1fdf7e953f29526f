"""The options of `plan-squeeze`, which wait for none of its imports."""

from argparse import ArgumentParser, ArgumentTypeError
from pathlib import Path

from mdms_host.cli.options import add_force, add_json, add_scenario, time_limit_s

COUNT_MAX = 1_000_000
#: As scenarios have them.
ANGLE_MAX_RAD = PLACE_MAX_M = 1000.0


def add_options(parser: ArgumentParser) -> None:
    """SCENARIO, and the rest."""
    add_scenario(parser)
    parser.add_argument("--parcel", metavar="NAME", help="which parcel (default: the first)")
    parser.add_argument(
        "--corners",
        metavar="'X,Y X,Y ...'",
        type=_corners,
        help="another polygon in its place: convex, counter-clockwise [m]",
    )
    parser.add_argument("--yaw", metavar="RAD", type=_angle, help="to end at this yaw")
    parser.add_argument(
        "--poses",
        metavar="N",
        type=_count,
        default=100,
        help="simulate the plan from so many random poses (default 100; 0: plan only)",
    )
    parser.add_argument("--seed", metavar="N", type=_count, help="instead of run.seed")
    parser.add_argument(
        "--time",
        metavar="SECONDS",
        type=time_limit_s,
        default=30.0,
        help="the longest that one squeeze lasts (default 30); it ends when the parcel rests",
    )
    parser.add_argument(
        "--out", metavar="FILE", type=Path, help="draw the plan, .png, .svg or .pdf"
    )
    add_force(parser)
    add_json(parser)


def _count(text: str) -> int:
    count = int(text)
    if not 0 <= count <= COUNT_MAX:
        raise ArgumentTypeError(f"{text} is not 0 to {COUNT_MAX}")
    return count


def _angle(text: str) -> float:
    angle_rad = float(text)
    if not abs(angle_rad) <= ANGLE_MAX_RAD:
        raise ArgumentTypeError(f"{text} is not within {ANGLE_MAX_RAD:g} rad")
    return angle_rad


def _corners(text: str) -> list[tuple[float, float]]:
    corners = [tuple(map(float, corner.split(","))) for corner in text.split()]
    if len(corners) < 3 or any(len(corner) != 2 for corner in corners):
        raise ArgumentTypeError(f"{text!r} is not three corners X,Y or more with spaces between")
    if not all(abs(place) <= PLACE_MAX_M for corner in corners for place in corner):
        raise ArgumentTypeError(f"{text!r} has a place beyond {PLACE_MAX_M:g} m")
    return [(x_m, y_m) for x_m, y_m in corners]
