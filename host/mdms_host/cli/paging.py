"""The page of a verb: opened at its port, its address printed first, and a browser if wanted."""

import webbrowser
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager

from mdms_host.cli.streams import say
from mdms_host.clock import MonotonicClock
from mdms_host.page.commands import ShownTable
from mdms_host.page.page import Page
from mdms_host.page.server import LOOPBACK


@contextmanager
def opened_page(table: ShownTable, arguments: Namespace) -> Iterator[Page]:
    """The page of a table as `--page`, `--host` and `--open` have it. Raises `PageError`."""
    host = arguments.host or LOOPBACK
    with Page(table, MonotonicClock(), arguments.page, host) as page:
        if not page.gate.is_loopback:
            say(
                f"mdms: the page is open to whoever reaches {host}: all may watch and "
                "stop, and whoever reads its address moves the table; it is not encrypted"
            )
        print(page.address, flush=True)
        if arguments.open:
            webbrowser.open(page.address)
        yield page
