"""`mdms plot`: a run as a picture."""

from argparse import Namespace
from pathlib import Path

from mdms_host.command.exits import CommandError, Exit
from mdms_host.command.inputs import open_run
from mdms_host.command.options import Verbs, add_run


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("plot", help="draw a run")
    add_run(parser)
    parser.add_argument(
        "--out", metavar="FILE.png", type=Path, help="the picture (default: RUN/picture.png)"
    )
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Draw the run and print the path of the picture."""
    stored = open_run(arguments.folder)
    path = arguments.out or arguments.folder / "picture.png"
    from mdms_sim.plots import save_picture

    try:
        save_picture(path, stored.scenario, stored.record)
    except OSError as error:
        raise CommandError(f"{path}: cannot be written: {error.strerror}", Exit.USAGE) from None
    print(path)
    return Exit.OK
