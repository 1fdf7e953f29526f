"""`mdms scan`: what is on the bus."""

import json
from argparse import Namespace
from dataclasses import asdict

from mdms_host.cli.array.bus import NOBODY, add_bus, telling_of_no_bus
from mdms_host.cli.console import show
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import Verbs, add_json


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("scan", help="list the nodes on the bus", late=add_bus)
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Ask every node who it is, and print the answers."""
    from mdms_host.can_link.link import open_bus
    from mdms_host.clock import MonotonicClock
    from mdms_host.commissioning.scan import scan, scan_table

    with telling_of_no_bus():
        nodes = scan(open_bus(arguments), MonotonicClock())
    if arguments.json:
        print(json.dumps({"nodes": [asdict(node) for node in nodes]}))
    elif nodes:
        show(scan_table(nodes))
    if not nodes:
        raise CommandError(NOBODY, Exit.NO_DEVICE)
    return Exit.OK
