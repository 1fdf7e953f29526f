"""`mdms configure`: node ids and settings of cells over the bus."""

from argparse import ArgumentParser, ArgumentTypeError
from pathlib import Path

from mdms_host.cli.array.bus import add_bus
from mdms_host.cli.options import Verbs, add_json

NODE_MIN, NODE_MAX = 1, 127
ALL = "all"
EPILOG = """\
A setting goes by its name (axis1.gain, or gain for all axes) or its object (0x2000:0); its value is
in SI units. `mdms configure show` lists them all.
"""


def add_to(verbs: Verbs) -> None:
    """Register the verb and what it can do."""
    parser = verbs.add_parser(
        "configure", help="node ids and settings of cells over the bus", epilog=EPILOG
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    _add_show(actions)
    _add_set(actions)
    _add_assign(actions)
    _add_files(actions)
    _add_restore(actions)


def nodes_of(texts: list[list[int] | str]) -> list[int] | None:
    """The node ids that `--node` names, in their order; None for all."""
    if not texts or ALL in texts:
        return None
    return sorted({node_id for some in texts for node_id in some if isinstance(node_id, int)})


def _add_show(actions: Verbs) -> None:
    parser = actions.add_parser(
        "show", help="settings of cells, and where they differ", late=add_bus
    )
    parser.add_argument("names", metavar="KEY", nargs="*", help="only these settings")
    _add_nodes(parser)
    parser.add_argument(
        "--wiring", action="store_true", help="also which frames carry what (PDOs, identifiers)"
    )
    add_json(parser)
    parser.set_defaults(run=lambda arguments: _run("show", arguments))


def _add_set(actions: Verbs) -> None:
    parser = actions.add_parser("set", help="change settings, and verify them", late=add_bus)
    parser.add_argument("assignments", metavar="KEY=VALUE", nargs="+", help="as in gain=10")
    _add_nodes(parser)
    _add_save(parser)
    _add_motors(parser)
    add_json(parser)
    parser.set_defaults(run=lambda arguments: _run("set", arguments))


def _add_assign(actions: Verbs) -> None:
    parser = actions.add_parser("assign", help="give cells their node ids by LSS", late=add_bus)
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--first",
        metavar="N",
        type=_node,
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
    parser.add_argument("--dry-run", action="store_true", help="only tell what would be done")
    add_json(parser)
    parser.set_defaults(run=lambda arguments: _run("assign", arguments))


def _add_files(actions: Verbs) -> None:
    dump = actions.add_parser("dump", help="write all settings of an array to a file", late=add_bus)
    dump.add_argument("file", metavar="FILE", type=Path, help="a TOML file, or - for stdout")
    _add_nodes(dump)
    dump.set_defaults(run=lambda arguments: _run("dump", arguments))
    load = actions.add_parser(
        "load", help="restore settings from a file, to cells by serial number", late=add_bus
    )
    load.add_argument("file", metavar="FILE", type=Path, help="a file that `dump` has written")
    _add_nodes(load)
    _add_save(load)
    _add_motors(load)
    _add_consent(load)
    load.set_defaults(run=lambda arguments: _run("load", arguments))


def _add_restore(actions: Verbs) -> None:
    parser = actions.add_parser(
        "restore-defaults", help="forget all stored settings but the node id", late=add_bus
    )
    _add_nodes(parser)
    _add_consent(parser)
    parser.set_defaults(run=lambda arguments: _run("restore", arguments))


def _add_nodes(parser: ArgumentParser) -> None:
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


def _run(module: str, arguments: object) -> int:
    """What an action does lies in a module of its own, read when it is needed."""
    from importlib import import_module

    return int(import_module(f"mdms_host.cli.configure.{module}").run(arguments))


def _nodes(text: str) -> list[int] | str:
    if text == ALL:
        return ALL
    first, dash, last = text.partition("-")
    low, high = _node(first), _node(last if dash else first)
    if low > high:
        raise ArgumentTypeError(f"{text} is no range of node ids")
    return list(range(low, high + 1))


def _node(text: str) -> int:
    if not text.isdecimal() or not NODE_MIN <= int(text) <= NODE_MAX:
        raise ArgumentTypeError(f"{text!r} is no node id, {NODE_MIN} to {NODE_MAX}")
    return int(text)
