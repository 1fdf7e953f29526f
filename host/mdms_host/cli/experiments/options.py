"""The options of `sweep` and `tune`."""

from argparse import ArgumentParser
from pathlib import Path

from mdms_host.cli.options import add_json


def add_sweep(parser: ArgumentParser) -> None:
    """Those of `sweep`."""
    parser.add_argument(
        "file", metavar="FILE", type=Path, help="a TOML file: scenario, over, seeds, measures"
    )
    add_executor(parser)
    parser.add_argument(
        "--records", action="store_true", help="keep the run folder of each run, in DIR/records"
    )
    parser.add_argument(
        "--again",
        metavar="ROW",
        type=int,
        help="repeat the run of one row of the table with its full record, in DIR/again-ROW",
    )
    add_json(parser)


def add_executor(parser: ArgumentParser) -> None:
    """Where runs are run and kept."""
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of journal, tables and pictures (default: runs/ and the name of FILE)",
    )
    parser.add_argument(
        "--workers", metavar="N", type=int, help="processes (default: one a processor)"
    )
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="run on a Dask cluster, by its scheduler's address"
    )
    parser.add_argument(
        "--changed",
        action="store_true",
        help="count runs of another revision of the code, and mark them",
    )


def add_tune(parser: ArgumentParser) -> None:
    """Those of `tune`."""
    parser.add_argument(
        "file", metavar="FILE", type=Path, help="a TOML file: scenario, vary, minimise, bounds"
    )
    add_executor(parser)
    add_json(parser)
