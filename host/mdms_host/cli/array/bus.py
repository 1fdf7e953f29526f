"""The bus of a verb: python-can's own options, and a link that is open while the verb runs."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

from can.cli import add_bus_arguments

from mdms_host.can_link.link import AnyLink, Link, open_bus
from mdms_host.can_link.links import Links
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


@contextmanager
def open_links(
    arguments: Namespace, channels: Sequence[str] = ()
) -> Iterator[tuple[AnyLink, Clock]]:
    """The bus that the options name, or several that differ in their channels.

    Raises NoBusError, DeviceGoneError.
    """
    if not channels:
        with open_link(arguments) as (link, clock):
            yield link, clock
        return
    clock = MonotonicClock()
    with ExitStack() as opened:
        buses = []
        for channel in channels:
            bus = open_bus(Namespace(**vars(arguments) | {"channel": channel}))
            opened.callback(bus.shutdown)
            buses.append(bus)
        # From here on the links close their buses.
        opened.pop_all()
        with Links(buses, channels, clock) as links:
            yield links, clock
