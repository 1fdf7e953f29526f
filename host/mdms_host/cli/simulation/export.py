"""`mdms export`: a run as tables."""

from argparse import Namespace
from pathlib import Path

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import Verbs, add_run
from mdms_host.cli.scenario.inputs import open_run


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("export", help="write a run as CSV tables")
    add_run(parser)
    parser.add_argument(
        "--csv",
        metavar="DIR",
        type=Path,
        required=True,
        help="folder for parcels.csv and cells.csv",
    )
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Write the tables and print their paths."""
    stored = open_run(arguments.folder)
    from mdms_model.run.csv_export import export_csv

    try:
        paths = export_csv(arguments.csv, stored.scenario, stored.record)
    except OSError as error:
        raise CommandError(
            f"{arguments.csv}: cannot be written: {error.strerror}", Exit.USAGE
        ) from None
    print(*paths, sep="\n")
    return Exit.OK
