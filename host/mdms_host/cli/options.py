"""Options that several verbs share."""

from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from argparse import _SubParsersAction

    Verbs: TypeAlias = _SubParsersAction[ArgumentParser]
else:
    Verbs = object

NODES = ("cpython", "micropython")


def add_scenario(parser: ArgumentParser) -> None:
    """SCENARIO and `--set`."""
    parser.add_argument(
        "scenario", metavar="SCENARIO", help="a TOML file, a run folder, or a name of `scenarios`"
    )
    add_overrides(parser)


def add_overrides(parser: ArgumentParser) -> None:
    """`--set`."""
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="overrides",
        help="change one value, as in parcel.0.x_m=-0.30 (may be given again)",
    )


def add_nodes(parser: ArgumentParser) -> None:
    """`--nodes`."""
    parser.add_argument(
        "--nodes",
        choices=NODES,
        default="cpython",
        help="what the cells' firmware runs on (default: cpython)",
    )


def add_run(parser: ArgumentParser) -> None:
    """RUN, the folder of an earlier run."""
    parser.add_argument("folder", metavar="RUN", type=Path, help="a run folder")


def add_json(parser: ArgumentParser) -> None:
    """`--json`."""
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
