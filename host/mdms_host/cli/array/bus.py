"""The bus of a verb: python-can's own options."""

from argparse import ArgumentParser

from can.cli import add_bus_arguments

NO_NODES = (
    "nobody is heard on the bus; is it connected and are the cells powered? "
    "`mdms serve array18` starts a virtual one"
)
TITLE = "CAN bus (python-can: also CAN_INTERFACE, CAN_CHANNEL, CAN_BITRATE and can.conf)"


def add_bus(parser: ArgumentParser) -> None:
    """python-can's options: -i, -c, -b and the rest."""
    add_bus_arguments(parser, group_title=TITLE)
