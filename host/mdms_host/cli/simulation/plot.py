"""`mdms plot`: a run as a picture."""

from argparse import Namespace
from pathlib import Path

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import Verbs, add_run
from mdms_host.cli.scenario.inputs import open_run


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("plot", help="draw a run")
    add_run(parser)
    parser.add_argument(
        "--wheels", action="store_true", help="contact, forces and slip of every wheel instead"
    )
    parser.add_argument(
        "--out", metavar="FILE.png", type=Path, help="the picture (default: in the run folder)"
    )
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Draw the run and print the path of the picture."""
    stored = open_run(arguments.folder)
    name = "wheels.png" if arguments.wheels else "picture.png"
    path = arguments.out or arguments.folder / name
    from mdms_sim.plots import save_picture, save_wheels

    save = save_wheels if arguments.wheels else save_picture
    try:
        save(path, stored.scenario, stored.record)
    except OSError as error:
        raise CommandError(f"{path}: cannot be written: {error.strerror}", Exit.USAGE) from None
    print(path)
    return Exit.OK
