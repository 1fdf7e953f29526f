"""`mdms configure`: its actions, and their options."""

from argparse import ArgumentParser, ArgumentTypeError
from pathlib import Path

from mdms_host.cli.options import add_force, add_json
from mdms_host.cli.parser import Verb
from mdms_protocol.codecs.cob import CELL_NODE_MAX, HOST_NODE, NODE_MAX, NODE_MIN

ALL = "all"
EPILOG = """\
A setting goes by its name (axis1.gain, or gain for all axes) or its object (0x2000:0); its value is
in SI units. `mdms configure show` lists them all.
"""
_HERE = "mdms_host.cli.configure"
_CELL_NODES = f"may be {NODE_MIN} to {CELL_NODE_MAX}"
_BUS = "mdms_host.cli.array.bus:add_bus"


def nodes_of(texts: list[list[int] | str]) -> list[int] | None:
    """The node ids that `--node` names, in their order; None for all."""
    if not texts or ALL in texts:
        return None
    return sorted({node_id for some in texts for node_id in some if isinstance(node_id, int)})


def _add_show(parser: ArgumentParser) -> None:
    parser.add_argument("names", metavar="KEY", nargs="*", help="only these settings")
    add_nodes(parser)
    parser.add_argument(
        "--wiring", action="store_true", help="also which frames carry what (PDOs, identifiers)"
    )
    add_json(parser)


def _add_set(parser: ArgumentParser) -> None:
    parser.add_argument("assignments", metavar="KEY=VALUE", nargs="+", help="as in gain=10")
    add_nodes(parser)
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
    add_nodes(parser)
    add_force(parser)
    add_json(parser)


def _add_load(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", type=Path, help="a file that `dump` has written")
    add_nodes(parser)
    _add_save(parser)
    _add_motors(parser)
    _add_consent(parser)


def _add_restore(parser: ArgumentParser) -> None:
    add_nodes(parser)
    _add_consent(parser)


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
            f"{_HERE}.show:run",
            _add_show,
            late_options=_BUS,
        ),
        Verb(
            "set",
            "change settings, and verify them",
            f"{_HERE}.set:run",
            _add_set,
            late_options=_BUS,
        ),
        Verb(
            "assign",
            "give cells their node ids by LSS",
            f"{_HERE}.assign:run",
            _add_assign,
            late_options=_BUS,
        ),
        Verb(
            "dump",
            "write all settings of an array to a file",
            f"{_HERE}.files:dump",
            _add_dump,
            late_options=_BUS,
        ),
        Verb(
            "load",
            "restore settings from a file, to cells by serial number",
            f"{_HERE}.files:load",
            _add_load,
            late_options=_BUS,
        ),
        Verb(
            "restore-defaults",
            "drop all stored settings but the node id",
            f"{_HERE}.restore:run",
            _add_restore,
            late_options=_BUS,
        ),
    ),
)
