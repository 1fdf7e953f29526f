"""`mdms stop`: everything off."""

import json
from argparse import Namespace
from dataclasses import asdict

from mdms_host.cli.array.bus import NOBODY, add_bus, open_link
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import Verbs, add_json


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("stop", help="turn every motor on the bus off", late=add_bus)
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Turn everything off and tell which cells have said so."""
    from mdms_host.commissioning.stop import stop_all

    with open_link(arguments) as (link, clock):
        report = stop_all(link, clock)
    if arguments.json:
        print(json.dumps(asdict(report)))
    if not report.heard:
        raise CommandError(NOBODY, Exit.NO_DEVICE)
    if report.not_off:
        nodes = ", ".join(map(str, report.not_off))
        raise CommandError(f"not off: node {nodes}; cut the motors' power", Exit.NODE_FAULT)
    if not arguments.json:
        print(f"{len(report.heard)} cells are off")
    return Exit.OK
