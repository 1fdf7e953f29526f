"""The verbs on single cells, with their options.

They are `configure`, `commission`, `doctor`, `identify` and `jog`.
"""

from argparse import ArgumentParser, ArgumentTypeError
from pathlib import Path

from mdms_host.cli.options import add_cells, add_force, add_json, add_table, number_of
from mdms_host.cli.parser import Verb
from mdms_protocol.codecs.cob import CELL_NODE_MAX, HOST_NODE, NODE_MAX, NODE_MIN

ALL = "all"
EPILOG = """\
A setting goes by its name (axis1.gain, or gain for all axes) or its object (0x2000:0); its value is
in SI units. `mdms configure show` lists them all.
"""
_CELLS = "mdms_host.cli.cells"
_CELL_NODES = f"may be {NODE_MIN} to {CELL_NODE_MAX}"
_BUS = "mdms_host.cli.options:add_bus"


def nodes_of(texts: list[list[int] | str]) -> list[int] | None:
    """The node ids that `--node` names, in their order; None for all."""
    if not texts or ALL in texts:
        return None
    return sorted({node_id for some in texts for node_id in some if isinstance(node_id, int)})


def _add_show(parser: ArgumentParser) -> None:
    parser.add_argument("names", metavar="KEY", nargs="*", help="only these settings")
    _add_table_nodes(parser)
    parser.add_argument(
        "--wiring", action="store_true", help="also which frames carry what (PDOs, identifiers)"
    )
    add_json(parser)


def _add_set(parser: ArgumentParser) -> None:
    parser.add_argument("assignments", metavar="KEY=VALUE", nargs="+", help="as in gain=10")
    _add_table_nodes(parser)
    _add_save(parser)
    _add_motors(parser)
    add_json(parser)


def _add_assign(parser: ArgumentParser) -> None:
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--first",
        metavar="N",
        type=cell_node,
        default=NODE_MIN,
        help="blank cells by serial number get free node ids from here (default 1)",
    )
    which.add_argument(
        "--from",
        metavar="FILE",
        type=Path,
        dest="file",
        help="cells, blank or not, get the node ids of a file of `dump`",
    )
    parser.add_argument("--dry-run", action="store_true", help="only print what would be done")
    add_json(parser)


def _add_dump(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", type=Path, help="a TOML file, or - for stdout")
    _add_table_nodes(parser)
    add_force(parser)
    add_json(parser)


def _add_load(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", type=Path, help="a file that `dump` has written")
    add_nodes(parser)
    _add_save(parser)
    _add_motors(parser)
    _add_consent(parser)


def _add_restore(parser: ArgumentParser) -> None:
    _add_table_nodes(parser)
    _add_consent(parser)


def _add_table_nodes(parser: ArgumentParser) -> None:
    """`--node`, and the table."""
    add_nodes(parser)
    add_table(parser)


def add_nodes(parser: ArgumentParser) -> None:
    """`--node`."""
    parser.add_argument(
        "--node",
        metavar="N",
        nargs="+",
        type=_nodes,
        default=[],
        dest="nodes",
        help="node ids, ranges such as 1-6, or all (default)",
    )


def _add_save(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--save", action="store_true", help="have the cells keep their settings without power"
    )


def _add_motors(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--scenario",
        metavar="SCENARIO",
        default="array18",
        help="whose motors bound the gain (default: those of array18)",
    )


def _add_consent(parser: ArgumentParser) -> None:
    parser.add_argument("--dry-run", action="store_true", help="only show what would change")
    parser.add_argument("--yes", action="store_true", help="do not ask")


def _nodes(text: str) -> list[int] | str:
    if text == ALL:
        return ALL
    first, dash, last = text.partition("-")
    if not (first[:1] or last[:1]).isdecimal():
        raise ArgumentTypeError(
            f"{text!r} is no node id, {NODE_MIN} to {NODE_MAX}; write all else before --node, as "
            "in: mdms configure set gain=12 --node 1-6"
        )
    low, high = _node(first), _node(last if dash else first)
    if low > high:
        raise ArgumentTypeError(f"{text} is no range of node ids")
    return list(range(low, high + 1))


def cell_node(text: str) -> int:
    """A node id that a cell may have; raises ArgumentTypeError."""
    if _node(text) == HOST_NODE:
        raise ArgumentTypeError(f"{text} is the host's own node id, a cell's {_CELL_NODES}")
    return _node(text)


def _node(text: str) -> int:
    if not text.isdecimal() or not NODE_MIN <= int(text) <= NODE_MAX:
        raise ArgumentTypeError(f"{text!r} is no node id, {NODE_MIN} to {NODE_MAX}")
    return int(text)


CONFIGURE = Verb(
    "configure",
    "node ids and settings of cells over the bus",
    epilog=EPILOG,
    actions=(
        Verb(
            "show",
            "settings of cells, and where they differ",
            f"{_CELLS}.configure_settings:show_settings",
            _add_show,
            late_options=_BUS,
        ),
        Verb(
            "set",
            "change settings, and verify them",
            f"{_CELLS}.configure_settings:set_settings",
            _add_set,
            late_options=_BUS,
        ),
        Verb(
            "assign",
            "give cells their node ids by LSS",
            f"{_CELLS}.configure_assign:run",
            _add_assign,
            late_options=_BUS,
        ),
        Verb(
            "dump",
            "write all settings of an array to a file",
            f"{_CELLS}.configure_files:dump",
            _add_dump,
            late_options=_BUS,
        ),
        Verb(
            "load",
            "restore settings from a file, to cells by serial number",
            f"{_CELLS}.configure_files:load",
            _add_load,
            late_options=_BUS,
        ),
        Verb(
            "restore-defaults",
            "drop all stored settings but the node id",
            f"{_CELLS}.configure_settings:restore_defaults",
            _add_restore,
            late_options=_BUS,
        ),
    ),
)


#: As 0x3007 takes it, and as a person waits.
_BLINK_MAX_S = 60.0
_JOG_MAX_S = 60.0
_JOG_MAX_M_S = 0.2
_SIDE_MAX = 126


def _add_identify(parser: ArgumentParser) -> None:
    _add_table_nodes(parser)
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
    parser.add_argument(
        "--array", metavar="FILE", type=Path, help="an array file: its bus and its bit rate"
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
        "--codes",
        action="store_true",
        help="places by the codes of the table's connectors (docs/boards.md)",
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
    add_cells(parser)
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
    return number_of(text, float, lambda value: low <= value <= high, f"{low:g} to {high:g} {unit}")


def _blink_s(text: str) -> float:
    return _between(text, 0.0, _BLINK_MAX_S, "s")


def _jog_s(text: str) -> float:
    return _between(text, 0.0, _JOG_MAX_S, "s")


def _jog_m_s(text: str) -> float:
    return _between(text, -_JOG_MAX_M_S, _JOG_MAX_M_S, "m/s")


COMMISSION = Verb(
    "commission",
    "from a bag of boards to an array, and its file",
    f"{_CELLS}.commission:run",
    _add_commission,
    late_options=_BUS,
)
DOCTOR = Verb(
    "doctor",
    "faults of an array, with cause and cure",
    f"{_CELLS}.doctor:run",
    _add_doctor,
    late_options=_BUS,
)
IDENTIFY = Verb(
    "identify",
    "have cells blink, to see which they are",
    f"{_CELLS}.asking:identify",
    _add_identify,
    late_options=_BUS,
)
JOG = Verb(
    "jog",
    "turn one wheel slowly, for the first sign of life",
    f"{_CELLS}.jog:run",
    _add_jog,
    late_options=_BUS,
)
