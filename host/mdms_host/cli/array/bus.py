"""Verbs that need a bus: python-can's own options, and a link that is open while they run."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from mdms_host.cli.exits import CommandError, Exit

if TYPE_CHECKING:
    from mdms_host.can_link.link import Link
    from mdms_host.clock import Clock

NOBODY = (
    "nobody is heard on the bus; is it connected and are the cells powered? "
    "`mdms serve array18` starts a virtual one"
)
TITLE = "CAN bus (python-can: also CAN_INTERFACE, CAN_CHANNEL, CAN_BITRATE and can.conf)"


def add_bus(parser: ArgumentParser) -> None:
    """python-can's options: -i, -c, -b and the rest."""
    from can.cli import add_bus_arguments

    add_bus_arguments(parser, group_title=TITLE)


@contextmanager
def telling_of_no_bus() -> Iterator[None]:
    """Turns a bus that cannot be opened, or goes away, into a `CommandError` (no device)."""
    from mdms_host.can_link.link import LinkError

    try:
        yield
    except LinkError as error:
        raise CommandError(str(error), Exit.NO_DEVICE) from None


@contextmanager
def open_link(arguments: Namespace) -> "Iterator[tuple[Link, Clock]]":
    """The bus that the options tell of. Raises `CommandError` (no bus or device)."""
    from mdms_host.can_link.link import Link, open_bus
    from mdms_host.clock import MonotonicClock

    clock = MonotonicClock()
    with telling_of_no_bus(), Link(open_bus(arguments), clock) as link:
        yield link, clock
