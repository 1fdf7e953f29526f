"""The verbs that bring an array into being, and their options."""

import math
from argparse import ArgumentParser, ArgumentTypeError

from mdms_host.cli.configure.options import add_nodes, cell_node
from mdms_host.cli.options import add_json
from mdms_host.cli.parser import Verb

#: As 0x3007 takes it, and as a person waits.
_BLINK_MAX_S = 60.0
_JOG_MAX_S = 60.0
_JOG_MAX_M_S = 0.2
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
        help=f"m/s, at most {_JOG_MAX_M_S:g} either way (default 0.05)",
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
    add_json(parser)


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
