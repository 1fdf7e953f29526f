"""`mdms identify`: cells blink, so that a person sees which they are."""

from argparse import Namespace

from mdms_host.cli.configure.cells import open_commissioning, present_nodes, ranges
from mdms_host.cli.configure.options import nodes_of
from mdms_host.cli.exits import Exit
from mdms_host.commissioning.network import Commissioning
from mdms_protocol import indices

_MS_PER_S = 1000


def run(arguments: Namespace) -> Exit:
    """Have the cells blink; they end it by themselves."""
    with open_commissioning(arguments) as commissioning:
        node_ids = present_nodes(commissioning, nodes_of(arguments.nodes))
        for node_id in node_ids:
            blink(commissioning, node_id, arguments.seconds)
    print(f"node {ranges(node_ids)}: both LEDs blink together for {arguments.seconds:g} s")
    return Exit.OK


def blink(commissioning: Commissioning, node_id: int, seconds: float) -> None:
    """Have a cell blink for so long, 0 to end it. Raises SilentError, RefusedError."""
    commissioning.write(node_id, indices.IDENTIFY, 0, round(seconds * _MS_PER_S))
