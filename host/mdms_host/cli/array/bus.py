"""The bus of a verb: python-can's own options, and a link that is open while the verb runs."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from contextlib import contextmanager

from can.cli import add_bus_arguments

from mdms_host.can_link.link import Link, open_bus
from mdms_host.clock import Clock, MonotonicClock

NO_NODES = (
    "nobody is heard on the bus; is it connected and are the cells powered? "
    "`mdms serve array18` starts a virtual one"
)
TITLE = "CAN bus (python-can: also CAN_INTERFACE, CAN_CHANNEL, CAN_BITRATE and can.conf)"


def add_bus(parser: ArgumentParser) -> None:
    """python-can's options: -i, -c, -b and the rest."""
    add_bus_arguments(parser, group_title=TITLE)


@contextmanager
def open_link(arguments: Namespace) -> Iterator[tuple[Link, Clock]]:
    """The bus that the options name. Raises NoBusError, DeviceGoneError."""
    clock = MonotonicClock()
    with Link(open_bus(arguments), clock) as link:
        yield link, clock
