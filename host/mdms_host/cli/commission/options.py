"""The verbs that bring an array into being, and their options."""

import math
from argparse import ArgumentParser, ArgumentTypeError
from pathlib import Path

from mdms_host.cli.configure.options import add_nodes, cell_node
from mdms_host.cli.options import add_force, add_json
from mdms_host.cli.parser import Verb

#: As 0x3007 takes it, and as a person waits.
_BLINK_MAX_S = 60.0
_JOG_MAX_S = 60.0
_JOG_MAX_M_S = 0.2
_SIDE_MAX = 126
_HERE = "mdms_host.cli.commission"
_BUS = "mdms_host.cli.array.bus:add_bus"


def _add_identify(parser: ArgumentParser) -> None:
    add_nodes(parser)
    parser.add_argument(
        "--seconds", metavar="S", type=_blink_s, default=5.0, help="for how long (default 5)"
    )


def _add_jog(parser: ArgumentParser) -> None:
    parser.add_argument(
        "speed",
        metavar="SPEED",
        nargs="?",
        type=_jog_m_s,
        default=0.05,
        help=f"reference in m/s, at most {_JOG_MAX_M_S:g} either way (default 0.05); "
        "a free wheel runs at some 0.8 of it",
    )
    parser.add_argument("--node", metavar="N", type=cell_node, required=True, help="whose wheel")
    parser.add_argument(
        "--axis", metavar="K", type=int, choices=(1, 2), required=True, help="which, 1 or 2"
    )
    how_long = parser.add_mutually_exclusive_group()
    how_long.add_argument(
        "--seconds", metavar="S", type=_jog_s, default=1.0, help="for how long (default 1)"
    )
    how_long.add_argument(
        "--keys", action="store_true", help="while + or - is held down; q ends it"
    )
    parser.add_argument(
        "--reset", action="store_true", help="reset the axis's fault first; its cause is removed"
    )
    add_json(parser)


def _add_commission(parser: ArgumentParser) -> None:
    way = parser.add_mutually_exclusive_group()
    way.add_argument(
        "--from",
        metavar="FILE",
        type=Path,
        dest="file",
        help="places, ids and settings by an array file, which is the whole of them",
    )
    way.add_argument(
        "--list", metavar="FILE", type=Path, help="serial numbers, one a line, along x first"
    )
    way.add_argument(
        "--plate",
        action="store_true",
        help="places by a plate of 10 to 18 cm that is moved over the table "
        "(default: each cell blinks, and you are asked)",
    )
    parser.add_argument("--columns", metavar="N", type=_side, help="cells along x")
    parser.add_argument("--rows", metavar="N", type=_side, help="cells along y")
    parser.add_argument("--pitch", metavar="M", type=_pitch, help="in m (default 0.127)")
    parser.add_argument(
        "--corner", metavar="SERIAL", type=_serial, help="of --plate: the cell at the origin"
    )
    parser.add_argument(
        "--limit", metavar="S", type=_limit_s, default=600.0, help="of --plate (default 600)"
    )
    parser.add_argument(
        "--again", action="store_true", help="ask for cells too that have their places already"
    )
    parser.add_argument(
        "--nudge",
        action="store_true",
        help="wheels may turn by a few millimetres: motor and encoder of each are checked",
    )
    parser.add_argument(
        "--out", metavar="FILE", type=Path, help="the array file (default: array.toml)"
    )
    parser.add_argument(
        "--key",
        metavar="FILE",
        type=Path,
        help="give all cells the key in this file, which is made if it is missing, for "
        "mdms flash --bus (default: the one beside the array file, if it is there)",
    )
    parser.add_argument("--yes", action="store_true", help="do not ask; without --nudge no motion")
    add_force(parser)
    add_json(parser)


def _add_doctor(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--array", metavar="FILE", type=Path, help="compare cells and settings with an array file"
    )
    parser.add_argument(
        "--empty", action="store_true", help="nothing lies on the table: no sensor may see anything"
    )
    way = parser.add_mutually_exclusive_group()
    way.add_argument(
        "--turn",
        action="store_true",
        help="wheels may turn, by some centimetres each: directions and scales are checked",
    )
    way.add_argument(
        "--stop",
        action="store_true",
        help="test the emergency stop: you are asked to press and to release it; its form is that "
        "of the array file, else short",
    )
    parser.add_argument(
        "--limit",
        metavar="S",
        type=_limit_s,
        default=60.0,
        help="of --stop: how long each hand may take (default 60)",
    )
    add_nodes(parser)
    parser.add_argument(
        "--scenario",
        metavar="SCENARIO",
        default="array18",
        help="whose motors the wheels have (default: those of array18)",
    )
    add_json(parser)


def _side(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= _SIDE_MAX:
        raise ArgumentTypeError(f"{text!r} is not 1 to {_SIDE_MAX}")
    return int(text)


def _pitch(text: str) -> float:
    return _between(text, 0.001, 1.0, "m")


def _limit_s(text: str) -> float:
    return _between(text, 0.1, 86_400.0, "s")


def _serial(text: str) -> int:
    try:
        serial = int(text, 16)
    except ValueError:
        serial = -1
    if not 0 <= serial <= 0xFFFFFFFF:
        raise ArgumentTypeError(f"{text!r} is no serial number of 8 hex digits")
    return serial


def _between(text: str, low: float, high: float, unit: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and low <= value <= high):
        raise ArgumentTypeError(f"{text} is not {low:g} to {high:g} {unit}")
    return value


def _blink_s(text: str) -> float:
    return _between(text, 0.0, _BLINK_MAX_S, "s")


def _jog_s(text: str) -> float:
    return _between(text, 0.0, _JOG_MAX_S, "s")


def _jog_m_s(text: str) -> float:
    return _between(text, -_JOG_MAX_M_S, _JOG_MAX_M_S, "m/s")


COMMISSION = Verb(
    "commission",
    "from a bag of boards to an array, and its file",
    f"{_HERE}.commission:run",
    _add_commission,
    late_options=_BUS,
)
DOCTOR = Verb(
    "doctor",
    "what is wrong with an array, why, and what helps",
    f"{_HERE}.doctor:run",
    _add_doctor,
    late_options=_BUS,
)
IDENTIFY = Verb(
    "identify",
    "have cells blink, to see which they are",
    f"{_HERE}.identify:run",
    _add_identify,
    late_options=_BUS,
)
JOG = Verb(
    "jog",
    "turn one wheel slowly, for the first sign of life",
    f"{_HERE}.jog:run",
    _add_jog,
    late_options=_BUS,
)
